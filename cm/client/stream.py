# SPDX-License-Identifier: Apache-2.0
"""Streams of a board: frames in DMA memory on the manager's machine, over ZeroMQ from elsewhere."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Protocol, TypeVar

from cm.client import calls
from cm.client.calls import Call
from cm.client.errors import RequestFailed
from cm.client.frame import Frame
from cm.client.link import STREAM_HWM, Link, Socket
from cm.client.plane import Connection
from cm.client.zmq_frames import ASK_FOR, STOPPED_PAUSE, Arrivals, Wanted, is_stopped
from cm.errors import Timeout
from cm.messages.requests import ConfigureStream
from cm.wire.encode import decode_reply, encode_request
from cm.wire.plane import Geometry, Open

_T = TypeVar("_T")
Self = TypeVar("Self", bound="Stream")


class Asker(Protocol):
    """What a stream needs of a board."""

    def ask(self, call: Call[_T], timeout: float | None = None) -> _T:
        """Make a request."""

    def subscribe(self, *topic: bytes, depth: int = 0) -> Socket:
        """A SUB socket."""


class Stream:
    """Frames of one stream. Iterating ends only by an exception; leaving the context closes it."""

    name: str

    def read(self, timeout: float | None = None) -> Frame:
        """The next frame. Raises Timeout."""
        raise NotImplementedError

    def open(self) -> None:
        """Connect; `read` does it by itself. Raises RequestNotFound for an unknown stream."""
        raise NotImplementedError

    def close(self) -> None:
        """Disconnect; twice is fine."""
        raise NotImplementedError

    @property
    def lost(self) -> int:
        """Frames that came while we were too slow."""
        raise NotImplementedError

    def __iter__(self) -> Iterator[Frame]:
        while True:
            yield self.read()

    def __enter__(self: Self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


class LocalStream(Stream):
    """Frames where the hardware put them: read-only arrays, leased until they have gone.

    `depth` frames at most are with us at a time (held, or waiting to be read); what comes while there
    are as many is lost to us. `newest`: what waits behind a newer frame is skipped. After a change of
    mode the frames go on, in the new shape.
    """

    def __init__(self, folder: Path, wanted: Open, timeout: float | None, newest: bool = False) -> None:
        self._folder = folder
        self._wanted = wanted
        self.name = wanted.name
        self._timeout = timeout
        self._newest = newest
        self._connection: Connection | None = None
        self._lost_before = 0

    def open(self) -> None:
        if self._connection is None:
            self._connection = self._opened()

    def _opened(self) -> Connection:
        """Connect; what the manager refuses is raised here. A stream that is stopped just now comes later."""
        connection = Connection(self._folder, self._wanted)
        try:
            connection.set_timeout(0.25)
            while connection.geometry is None:
                connection.receive()
        except BlockingIOError:
            pass
        except BaseException:
            connection.close()
            raise
        return connection

    @property
    def geometry(self) -> Geometry | None:
        """Shape, dtype, slots as they are now; None while the stream is stopped."""
        return self._connection.geometry if self._connection else None

    @property
    def lost(self) -> int:
        return self._lost_before + (self._connection.lost if self._connection else 0)

    @property
    def is_open(self) -> bool:
        """Whether it is connected."""
        return self._connection is not None

    def fileno(self) -> int:
        """Descriptor that polls readable when `poll` has something to do."""
        self.open()
        assert self._connection is not None
        return self._connection.socket.fileno()

    def read(self, timeout: float | None = None) -> Frame:
        connection = self._connection
        if connection is None:
            self.open()
            connection = self._connection
            assert connection is not None
        limit = self._timeout if timeout is None else timeout
        connection.set_timeout(limit)
        until = None if limit is None else time.monotonic() + limit
        try:
            while (frame := connection.receive()) is None:
                if until is not None:
                    connection.set_timeout(max(0.0, until - time.monotonic()))
        except BlockingIOError:
            raise Timeout(self.nothing(limit)) from None
        return self._latest(connection, frame) if self._newest else frame

    def poll(self) -> Frame | None:
        """The next frame if it is there already; never waits."""
        self.open()
        connection = self._connection
        assert connection is not None
        try:
            while (frame := connection.receive(socket.MSG_DONTWAIT)) is None:
                pass
        except BlockingIOError:
            return None
        return self._latest(connection, frame) if self._newest else frame

    def _latest(self, connection: Connection, frame: Frame) -> Frame:
        while True:
            try:
                newer = connection.receive(socket.MSG_DONTWAIT)
            except BlockingIOError:
                return frame
            if newer is not None:
                frame.release()
                frame = newer

    def nothing(self, limit: float | None) -> str:
        """Why nothing may have come, for people."""
        text = f"stream {self.name!r} gave no frame within {limit or 0:g} s"
        geometry = self.geometry
        if geometry is None:
            return f"{text}: it is stopped"
        if self._connection and self._connection.held >= geometry.depth:
            return f"{text}: all {geometry.depth} frames that may be held are; keep copies, or ask for a larger depth"
        return text

    def close(self) -> None:
        if self._connection is not None:
            self._lost_before += self._connection.lost
            self._connection.close()
            self._connection = None


class RemoteStream(Stream):
    """Frames over ZeroMQ; losses show in `sequence`."""

    def __init__(self, board: Asker, wanted: Wanted) -> None:
        self._board = board
        self._wanted = wanted
        self.name = wanted.name
        self._socket: Socket | None = None
        self._arrivals = Arrivals()

    def open(self) -> None:
        self._opened()

    def _opened(self) -> Socket:
        if self._socket is None:
            # raises for an unknown stream, and for what the manager cannot compress with
            self._board.ask(calls.configure_stream(ConfigureStream(self.name, compression=self._wanted.compression)))
            self._socket = self._board.subscribe(self._wanted.topic, depth=self._wanted.depth or STREAM_HWM)
        return self._socket

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    def read(self, timeout: float | None = None) -> Frame:
        limit = self._wanted.timeout if timeout is None else timeout
        return self._arrivals.frame(receive(self._opened(), limit))

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class NewestStream(Stream):
    """The next frame from when it is asked for, over ZeroMQ: nothing waits anywhere, and nothing is sent in vain."""

    def __init__(self, connect: Callable[[], Link], wanted: Wanted) -> None:
        self._connect = connect
        self._wanted = wanted
        self.name = wanted.name
        self._link: Link | None = None
        self._arrivals = Arrivals()

    def open(self) -> None:
        try:
            self._ask(calls.describe_stream(self.name), 5.0)  # raises for an unknown stream
        except BaseException:
            self.close()
            raise

    @property
    def lost(self) -> int:
        return self._arrivals.lost

    def _ask(self, call: Call[_T], timeout: float) -> _T:
        if self._link is None:
            self._link = self._connect()
        return call.result(decode_reply(self._link.ask(encode_request(call.request), timeout)))

    def read(self, timeout: float | None = None) -> Frame:
        limit = self._wanted.timeout if timeout is None else timeout
        until = None if limit is None else time.monotonic() + limit
        while True:
            left = ASK_FOR if until is None else min(ASK_FOR, until - time.monotonic())
            if left <= 0:
                raise Timeout(f"stream {self.name!r} gave no frame within {limit:g} s")
            try:
                return self._arrivals.count(self._ask(calls.read_data(self.name, left), left + 5.0))
            except RequestFailed as error:
                if is_stopped(error):
                    time.sleep(min(STOPPED_PAUSE, left))
                elif not isinstance(error, Timeout):
                    raise

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None


def receive(socket: Socket, timeout: float | None) -> list[bytes]:
    """A message. Raises Timeout after `timeout` seconds."""
    if not socket.poll(None if timeout is None else int(timeout * 1000)):
        raise Timeout(f"nothing came within {timeout:g} s")
    return socket.recv_multipart()
