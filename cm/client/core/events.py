# SPDX-License-Identifier: Apache-2.0
"""Events that a client subscribes to: statuses, register changes, interrupts; none is missed after subscribing."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from cm.client.core import calls, registers
from cm.client.core.flow_effects import DEFAULT, Ask, Deadline, Flow, Limit, Receive, Subscription, at_least, seconds
from cm.errors import Timeout
from cm.wire import topics
from cm.wire.encode import decode_event
from cm.wire.messages.status import ConfigInfo, Irq, RegValues, Status

T = TypeVar("T")
_ANSWER = 5.0  # least seconds that subscribing waits for the manager's answer
_SOON = 1.0  # the same in one call that subscribes and waits


class Events(Generic[T]):
    """Events of one kind on a subscription of one's own. `opening` comes first."""

    topics: tuple[bytes, ...] = ()

    def __init__(self, subscription: Subscription, timeout: float | None) -> None:
        self.subscription = subscription
        self._timeout = timeout

    def opening(self) -> Flow[None]:
        """Returns when no later event can be missed."""
        yield from ()

    def accept(self, event: Any) -> T | None:
        """The event in the form that is wanted; None if it is not one of ours."""
        raise NotImplementedError

    def nothing(self, limit: float | None) -> str:
        """The error text if none came."""
        return f"nothing came within {limit or 0:g} s"

    def take(self, frames: list[bytes]) -> T | None:
        """A message → the event; None if it is not one of ours."""
        return self.accept(decode_event(frames))

    def next(self, timeout: Limit = DEFAULT) -> Flow[T]:
        """The next one. Raises Timeout; other messages meanwhile do not prolong it."""
        deadline = Deadline(seconds(timeout, self._timeout))
        while True:
            frames = yield Receive(self.subscription, deadline.left)
            if frames is None:
                raise Timeout(self.nothing(deadline.limit))
            event = self.take(frames)
            if event is not None:
                return event

    def _settled(self, least: float = _ANSWER) -> Flow[Deadline]:
        """Wait until the manager has our subscriptions.

        It applies them in order, and sends the current status at once to a new subscriber to it, so when this comes,
        the topics subscribed to before it are in effect (docs/protocol.md). That is the manager's answer, so a
        time-out that is meant for events does not cut it short below `least`. What is left is for the other answers.
        """
        deadline = Deadline(at_least(self._timeout, least))
        while True:
            frames = yield Receive(self.subscription, deadline.left)
            if frames is None:
                raise Timeout(f"the manager published no status within {deadline.limit or 0:g} s")
            if isinstance(decode_event(frames), Status):
                self.subscription.unsubscribe(topics.STATUS)
                return deadline


class StatusEvents(Events[Status]):
    """Every status from now on, the current one first."""

    topics = (topics.STATUS,)

    def accept(self, event: Any) -> Status | None:
        return event if isinstance(event, Status) else None


class RegisterEvents(Events[RegValues]):
    """All writes of registers from now on, by any client, with the values afterwards. `names`: only these, or
    those with these fields.
    """

    topics = (topics.READ_REG, topics.STATUS)

    def __init__(self, subscription: Subscription, timeout: float | None, names: tuple[str, ...]) -> None:
        super().__init__(subscription, timeout)
        self._asked = names
        self._names = frozenset(str(name).partition(".")[0] for name in names)

    def opening(self) -> Flow[None]:
        """Raises RequestNotFound for a name that no mode of what is loaded has: nothing would ever come."""
        yield from self._settled()
        if self._asked:
            config: ConfigInfo = yield Ask(calls.describe())
            if config.name:  # else what is loaded next may have them
                registers.check(self._asked, config.registers, f"in configuration {config.name!r}")

    def accept(self, event: Any) -> RegValues | None:
        if not isinstance(event, RegValues):
            return None
        if not self._names:
            return event
        values = tuple([v for v in event.values if v.name in self._names])
        return event._replace(values=values) if values else None


class InterruptEvents(Events[Irq]):
    """Each interrupt of one name from now on; with `since`, the latest one first if it is not that of then.

    `since` is a time of an interrupt in ns (0: none), as counts start again with each configuration. The time-out is
    for all then: opening, which may take `_SOON` though, and the event.
    """

    topics = (topics.IRQ, topics.STATUS)

    def __init__(self, subscription: Subscription, timeout: float | None, name: str, since: int | None = None) -> None:
        super().__init__(subscription, timeout)
        self._name = name
        self._since = since
        self._after = 0
        self._came: Irq | None = None
        self._whole = Deadline(self._timeout)

    def opening(self) -> Flow[None]:
        deadline = yield from self._settled(_ANSWER if self._since is None else _SOON)
        latest: Irq = yield Ask(calls.interrupt(self._name), deadline.left)
        self._after = latest.timestamp_ns
        if self._since is not None and latest.count and latest.timestamp_ns != self._since:
            self._came = latest

    def next(self, timeout: Limit = DEFAULT) -> Flow[Irq]:
        """The one that came before, or the next one. Raises Timeout."""
        if self._came is None:
            return (yield from super().next(timeout if self._since is None else self._whole.left))
        came, self._came = self._came, None
        return came

    def accept(self, event: Any) -> Irq | None:
        new = isinstance(event, Irq) and event.name == self._name and event.timestamp_ns > self._after
        return event if new else None

    def nothing(self, limit: float | None) -> str:
        limit = limit if self._since is None else self._timeout
        return f"interrupt {self._name!r} did not come within {limit or 0:g} s"
