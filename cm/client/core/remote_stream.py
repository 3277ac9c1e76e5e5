# SPDX-License-Identifier: Apache-2.0
"""Frames over ZeroMQ: subscribed to, or requested one by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from cm.client.core import calls
from cm.client.core.effects import Ask, Deadline, Flow, Limit, Pause, Receive, Subscription, later, seconds
from cm.client.errors import RequestFailed, RequestTimeout
from cm.client.frame import Frame
from cm.client.zmq_frames import ASK_FOR, STOPPED_PAUSE, Arrivals, Wanted, is_stopped
from cm.errors import Timeout
from cm.wire.messages.requests import ConfigureStream

STREAM_HWM = 4  # frames that wait in a slow reader's socket before newer ones are lost
_ANSWER = 5.0  # seconds beyond a frame's own time-out until its reply counts as missing
_LEAST = 1e-3  # seconds that the manager is asked to wait at least: 0 would mean its own default


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
        self._arrivals = Arrivals()

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    def opening(self) -> Flow[None]:
        if self._subscription is None:
            # raises for an unknown stream, and for a compression that the manager does not have
            yield Ask(calls.configure_stream(ConfigureStream(self._wanted.name, compression=self._wanted.compression)))
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
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None


class NewestReader:
    """Requests each frame when it is read: no frame waits anywhere, and none is sent in vain."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        self._arrivals = Arrivals()

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    def opening(self) -> Flow[None]:
        yield Ask(calls.describe_stream(self._wanted.name))  # raises for an unknown stream

    def reading(self, timeout: Limit) -> Flow[Frame]:
        deadline = Deadline(seconds(timeout, self._wanted.timeout))
        while True:
            left = ASK_FOR if deadline.left is None else min(ASK_FOR, deadline.left)
            if left <= 0:
                raise _nothing(self._wanted.name, deadline.limit)
            try:
                frame: Frame = yield Ask(calls.read_data(self._wanted.name, left), left + _ANSWER)
                return self._arrivals.count(frame)
            except RequestFailed as error:
                if is_stopped(error):
                    yield Pause(min(STOPPED_PAUSE, left))
                elif not isinstance(error, Timeout):
                    raise

    def close(self) -> None:
        """Nothing is open between two reads."""


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
