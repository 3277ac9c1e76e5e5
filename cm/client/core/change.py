# SPDX-License-Identifier: Apache-2.0
"""A change of mode, as the client that asked for it sees it."""

from __future__ import annotations

from collections.abc import Callable

from cm.client.core.calls import Call, ended
from cm.client.core.flow_effects import Ask, AskBeside, Deadline, Flow, Limit, Receive, Subscription
from cm.errors import Timeout
from cm.wire.encode import decode_event
from cm.wire.messages.status import ChangeInfo, Progress, Status

OnProgress = Callable[[Progress], None]
_PATIENCE = 5.0  # seconds to wait for publications; later ones are not passed on


def loading(
    call: Call[ChangeInfo], timeout: Limit, subscription: Subscription | None, progress: OnProgress | None
) -> Flow[float]:
    """Go to a mode and wait for it; returns the seconds that it took. `progress` is told of each step meanwhile."""
    if subscription is None or progress is None:
        info: ChangeInfo = yield Ask(call, timeout)
        return info.seconds

    told = _Told(progress)
    yield Receive(subscription, _PATIENCE)  # the manager sends the current status at once: from here on it tells us
    info = yield AskBeside(call, timeout, subscription, told.take)
    yield from told.until(info.number, subscription)
    return info.seconds


class _Told:
    """Passes on the progress of published statuses."""

    def __init__(self, progress: OnProgress) -> None:
        self._progress = progress
        self._last_change = 0

    def take(self, frames: list[bytes]) -> None:
        event = decode_event(frames)
        if isinstance(event, Status):
            self._last_change = event.last_change
            if event.progress is not None:
                self._progress(event.progress)

    def until(self, number: int, subscription: Subscription) -> Flow[None]:
        """The reply may overtake what was published before it: take what is missing up to the change's end."""
        deadline = Deadline(_PATIENCE)
        while self._last_change < number:
            frames = yield Receive(subscription, deadline.left)
            if frames is None:
                return
            self.take(frames)


class ChangeWatch:
    """A change that was asked for without waiting, followed by the statuses that are published."""

    def __init__(self, number: int, subscription: Subscription) -> None:
        self.number = number
        self.subscription = subscription
        self.progress: Progress | None = None
        self._ended: Status | None = None

    @property
    def has_ended(self) -> bool:
        """Whether it has ended, well or not, as far as the messages so far say."""
        return self._ended is not None

    def take(self, frames: list[bytes]) -> None:
        """Note what a message says."""
        event = decode_event(frames)
        if isinstance(event, Status) and self._ended is None:
            self.progress = event.progress
            if event.last_change >= self.number:
                self._ended = event

    def arrived(self) -> Flow[bool]:
        """Whether it has ended by now; reads waiting messages, and never waits itself."""
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
