# SPDX-License-Identifier: Apache-2.0
"""What a flow may wait for. Each client has one function that runs flows, with its own way of waiting."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from enum import Enum
from typing import Any, Protocol, TypeVar

from cm.client.core.calls import Call
from cm.errors import InvalidRequest
from cm.frozen import dataclass

_T = TypeVar("_T")


class Default(Enum):
    """A time-out that was not given: that of the board, or of the stream."""

    DEFAULT = "default"

    def __repr__(self) -> str:
        return "DEFAULT"


DEFAULT = Default.DEFAULT
Limit = float | None | Default  # seconds; None waits for ever
_EVER = 2e6  # seconds, 23 days: poll(2) takes milliseconds as an int


def seconds(limit: Limit, default: float | None) -> float | None:
    """A time-out in seconds; None waits for ever. `default` is one already. Raises InvalidRequest."""
    return default if isinstance(limit, Default) else time_limit(limit)


def time_limit(limit: float | None) -> float | None:
    """A time-out as every way of waiting takes it: None waits for ever, as infinity does; what is over is 0.

    Raises InvalidRequest for what is not a time.
    """
    try:
        if limit is None or 0.0 <= limit < _EVER:
            return limit
        if limit == limit:  # not NaN
            return 0.0 if limit < 0 else None
    except TypeError:
        pass
    raise InvalidRequest(f"a time-out is a number of seconds, or None to wait for ever; not {limit!r}")


def at_least(limit: float | None, least: float) -> float | None:
    """A time-out for what may take longer than other requests."""
    return None if limit is None else max(limit, least)


def later(limit: float | None, by: float) -> float | None:
    """A time-out for an answer that comes `by` seconds later than others."""
    return None if limit is None else limit + by


class Subscription(Protocol):
    """A subscription to topics; neither method waits."""

    def unsubscribe(self, topic: bytes) -> None:
        """Stop listening to one of them."""

    def close(self) -> None:
        """Stop listening; twice is fine."""


@dataclass(frozen=True, slots=True)
class Ask:
    """A request; its result is what `Call.result` gives, or raises."""

    call: Call[Any]
    timeout: Limit = DEFAULT


@dataclass(frozen=True, slots=True)
class AskBeside:
    """A request during which `take` is given the messages of a subscription."""

    call: Call[Any]
    timeout: Limit
    subscription: Any
    take: Callable[[list[bytes]], None]


@dataclass(frozen=True, slots=True)
class Receive:
    """The next message of a subscription as its frames; None if there is none within `timeout` seconds."""

    subscription: Any
    timeout: float | None


@dataclass(frozen=True, slots=True)
class Pause:
    """Nothing, for some seconds."""

    seconds: float


Effect = Call[Any] | Ask | AskBeside | Receive | Pause  # a plain call is made with the board's time-out
Flow = Generator[Effect, Any, _T]


class Deadline:
    """A time-out that messages in between do not prolong. Seconds of CLOCK_MONOTONIC. Raises InvalidRequest."""

    def __init__(self, limit: float | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.limit = time_limit(limit)
        self._clock = clock
        self._until = None if self.limit is None else clock() + self.limit

    @property
    def left(self) -> float | None:
        """Seconds that are left, never less than 0; None without a time-out."""
        return None if self._until is None else max(0.0, self._until - self._clock())
