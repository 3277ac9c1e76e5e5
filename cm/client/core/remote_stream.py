# SPDX-License-Identifier: Apache-2.0
"""Frames over ZeroMQ, subscribed to or requested one by one, without sockets: shared by both clients' streams."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from cm.client.core import calls
from cm.client.core.flow_effects import (
    Ask,
    Deadline,
    Flow,
    Limit,
    Pause,
    Receive,
    Subscription,
    later,
    seconds,
    time_limit,
)
from cm.client.errors import RequestFailed, RequestTimeout
from cm.client.frame import Frame, frame_of
from cm.errors import InvalidRequest, Timeout
from cm.frozen import dataclass, replace
from cm.wire import topics
from cm.wire.encode import decode_event
from cm.wire.messages.requests import ConfigureStream
from cm.wire.messages.status import FrameInfo

STOPPED_PAUSE = 0.05  # seconds until a stream that is stopped for a change is requested again
ASK_FOR = 5.0  # seconds that one request for the newest frame waits for it
STREAM_HWM = 4  # frames that wait in a slow reader's socket before newer ones are lost
_ANSWER = 5.0  # seconds beyond a frame's own time-out until its reply counts as missing
_LEAST = 1e-3  # seconds that the manager is asked to wait at least: 0 would mean its own default


@dataclass(frozen=True, slots=True)
class Wanted:
    """A stream over ZeroMQ. `newest`: each read requests the next frame; otherwise frames are subscribed to."""

    name: str
    timeout: float | None
    newest: bool = False
    depth: int = 0  # frames that wait in our socket before newer ones are lost, 0: the usual number
    raw: bool = False  # pixels as they lie in memory, whatever the stream's format

    def __post_init__(self) -> None:
        """Refuse impossible combinations. Raises InvalidRequest."""
        time_limit(self.timeout)
        if self.depth < 0:
            raise InvalidRequest(f"a stream of depth {self.depth}: frames that may wait are 1 or more")

    @property
    def topic(self) -> bytes:
        """What to subscribe to."""
        return topics.STREAM_PREFIX + self.name.encode()


class Arrivals:
    """Published messages → frames; counts those that are missing between them."""

    def __init__(self, raw: bool = False) -> None:
        self._raw = raw
        self.lost = 0
        self._expected: int | None = None
        self._failed = 0

    def frame(self, frames: Sequence[Any]) -> Frame:
        """Raises InvalidRequest for what is not a frame."""
        info = decode_event(frames)
        if not isinstance(info, FrameInfo) or len(frames) != 3:
            raise InvalidRequest(f"{type(info).__name__} in {len(frames)} parts came on a stream's topic")
        return self.count(frame_of(info, frames[2], self._raw))

    def count(self, frame: Frame) -> Frame:
        """Note the frame's number, and on it what is missing before it, and why."""
        info = frame.info
        lost = max(0, info.sequence - self._expected) if self._expected is not None else 0
        failed = min(max(0, info.failed - self._failed), lost)
        self._expected, self._failed = info.sequence + 1, info.failed
        self.lost += lost
        if lost or info.failed:
            frame._info = replace(info, failed=failed, lost=lost)
        return frame


def closed(name: str) -> InvalidRequest:
    """The error for any use of a stream after it was closed."""
    return InvalidRequest(f"the stream {name!r} was closed: ask for another, board.stream({name!r})")


def is_stopped(error: RequestFailed) -> bool:
    """Whether a stream is only stopped while its region changes."""
    return error.code == "stream_stopped"


class Reader(Protocol):
    """Either of the two."""

    @property
    def lost(self) -> int:
        """Frames that are missing between those that came."""

    def opening(self) -> Flow[None]:
        """Raises RequestNotFound for an unknown stream."""

    def reading(self, timeout: Limit) -> Flow[Frame]:
        """The next frame. Raises Timeout."""

    def close(self) -> None:
        """Twice is fine."""


class PublishedReader:
    """Frames that are published to all who subscribe; losses show in `sequence`."""

    def __init__(self, wanted: Wanted, subscribe: Callable[[bytes, int], Subscription]) -> None:
        self._wanted = wanted
        self._subscribe = subscribe
        self._subscription: Subscription | None = None
        self._closed = False
        self._arrivals = Arrivals(wanted.raw)

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    def opening(self) -> Flow[None]:
        if self._closed:
            raise closed(self._wanted.name)
        if self._subscription is None:
            yield Ask(calls.configure_stream(ConfigureStream(self._wanted.name)))  # raises for an unknown stream
            self._subscription = self._subscribe(self._wanted.topic, self._wanted.depth or STREAM_HWM)

    def reading(self, timeout: Limit) -> Flow[Frame]:
        yield from self.opening()
        deadline = Deadline(seconds(timeout, self._wanted.timeout))
        while True:
            frames = yield Receive(self._subscription, deadline.left)
            if frames is None:
                raise _nothing(self._wanted.name, deadline.limit)
            if bytes(frames[0]) == self._wanted.topic:  # not a stream whose name begins with this one's
                return self._arrivals.frame(frames)

    def close(self) -> None:
        self._closed = True
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None


class NewestReader:
    """Requests each frame when it is read: no frame waits anywhere, and none is sent in vain."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        self._closed = False
        self._arrivals = Arrivals()

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    def opening(self) -> Flow[None]:
        self._check()
        yield Ask(calls.describe_stream(self._wanted.name))  # raises for an unknown stream

    def _check(self) -> None:
        if self._closed:
            raise closed(self._wanted.name)

    def reading(self, timeout: Limit) -> Flow[Frame]:
        self._check()
        deadline = Deadline(seconds(timeout, self._wanted.timeout))
        while True:
            left = ASK_FOR if deadline.left is None else min(ASK_FOR, deadline.left)
            if left <= 0:
                raise _nothing(self._wanted.name, deadline.limit)
            try:
                frame: Frame = yield Ask(calls.read_data(self._wanted.name, left, self._wanted.raw), left + _ANSWER)
                return self._arrivals.count(frame)
            except RequestFailed as error:
                if is_stopped(error):
                    yield Pause(min(STOPPED_PAUSE, left))
                elif not isinstance(error, Timeout):
                    raise

    def close(self) -> None:
        self._closed = True  # nothing is open between two reads


def reading_next(name: str, timeout: float | None, answer: float | None) -> Flow[Frame]:
    """The next frame in one request; without a time-out in as many as it takes. `answer`: as long as others take."""
    deadline = Deadline(timeout)
    part = ASK_FOR if deadline.limit is None else max(deadline.limit, _LEAST)
    while True:
        try:
            frame: Frame = yield Ask(calls.read_data(name, part), later(answer, part))
        except RequestTimeout:
            if deadline.limit is not None:
                raise
        else:
            return frame


def _nothing(name: str, limit: float | None) -> Timeout:
    return Timeout(f"stream {name!r} gave no frame within {limit or 0:g} s")
