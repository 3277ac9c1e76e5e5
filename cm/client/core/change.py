# SPDX-License-Identifier: Apache-2.0
"""A change of mode as its asker sees it."""

from __future__ import annotations

from collections.abc import Callable

from cm.client.core.calls import Call, ended
from cm.client.core.effects import Ask, AskBeside, Deadline, Flow, Limit, Receive, Subscription
from cm.errors import Timeout
from cm.messages.status import ChangeInfo, Progress, Status
from cm.wire.encode import decode_event

OnProgress = Callable[[Progress], None]
_PATIENCE = 5.0  # seconds for what is published; what comes later is not told


def loading(
    call: Call[ChangeInfo], timeout: Limit, subscription: Subscription | None, progress: OnProgress | None
) -> Flow[float]:
    """Go to a mode and wait for it; returns the seconds that it took. `progress` is told of each step meanwhile."""
    if subscription is None or progress is None:
        info: ChangeInfo = yield Ask(call, timeout)
        return info.seconds

    def take(frames: list[bytes]) -> None:
        event = decode_event(frames)
        if isinstance(event, Status) and event.progress is not None:
            progress(event.progress)

    yield from _begun(subscription)
    info = yield AskBeside(call, timeout, subscription, take)
    yield from _caught_up(subscription, info.number, take)
    return info.seconds


def _begun(subscription: Subscription) -> Flow[None]:
    """Wait until the manager tells us statuses: it sends the current one at once."""
    yield Receive(subscription, _PATIENCE)


def _caught_up(subscription: Subscription, number: int, take: Callable[[list[bytes]], None]) -> Flow[None]:
    """The reply may overtake what was published before it: take all up to the change's end."""
    deadline = Deadline(_PATIENCE)
    while True:
        frames = yield Receive(subscription, deadline.left)
        if frames is None:
            return
        take(frames)
        event = decode_event(frames)
        if isinstance(event, Status) and event.last_change >= number:
            return


class ChangeWatch:
    """A change that was asked for without waiting, followed by the statuses that are published."""

    def __init__(self, number: int, subscription: Subscription) -> None:
        self.number = number
        self.subscription = subscription
        self.progress: Progress | None = None
        self._ended: Status | None = None

    @property
    def has_ended(self) -> bool:
        """Whether it has, well or not, as far as the messages that were taken tell."""
        return self._ended is not None

    def take(self, frames: list[bytes]) -> None:
        """Note what a message says."""
        event = decode_event(frames)
        if isinstance(event, Status) and self._ended is None:
            self.progress = event.progress
            if event.last_change >= self.number:
                self._ended = event

    def arrived(self) -> Flow[bool]:
        """Whether it has ended by now; takes what is there, and never waits."""
        while self._ended is None:
            frames = yield Receive(self.subscription, 0.0)
            if frames is None:
                return False
            self.take(frames)
        return True

    def waiting(self, timeout: float | None) -> Flow[float]:
        """Wait for its end; returns its seconds. Raises RequestFailed, Timeout."""
        deadline = Deadline(timeout)
        while self._ended is None:
            frames = yield Receive(self.subscription, deadline.left)
            if frames is None:
                raise Timeout(f"change {self.number} has not ended within {timeout or 0:g} s")
            self.take(frames)
        self.subscription.close()
        return ended(self._ended, self.number)
