# SPDX-License-Identifier: Apache-2.0
"""Streams of a board: frames in DMA memory on the manager's machine, over ZeroMQ on others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from cm.client.core.flow_effects import DEFAULT, Deadline, Flow, Limit, at_least, seconds, time_limit
from cm.client.core.generations import FirstAfter, Written
from cm.client.core.remote_stream import NewestReader, PublishedReader, Reader, Wanted, closed
from cm.client.errors import ConnectionLost
from cm.client.frame import Frame
from cm.client.request_reply import Link
from cm.errors import CmError, Timeout
from cm.wire.plane_packets import Geometry, Open

if TYPE_CHECKING:
    from cm.client.data_connection import DataConnection
    from cm.client.request_reply import Caller

_T = TypeVar("_T")
_ANSWER = 5.0  # least seconds that opening a stream waits for the manager's answer
Self = TypeVar("Self", bound="Stream")


class Stream:
    """Frames of one stream. Iterating ends only by an exception; leaving the context closes it."""

    name: str
    _timeout: float | None

    def read(self, timeout: Limit = DEFAULT) -> Frame:
        """The next frame. `timeout` in seconds (None waits for ever; default: the stream's). Raises Timeout."""
        raise NotImplementedError

    def after(self, write: Written | int, timeout: Limit = DEFAULT) -> Frame:
        """The first frame that began after a write was complete; earlier ones are skipped.

        `write` is what `registers.write` returned, or a generation of the registers. Raises Timeout.
        """
        wanted = FirstAfter(self.name, write, timeout, self._timeout)
        while True:
            try:
                frame = self.read(wanted.left())
            except Timeout:
                raise wanted.nothing() from None
            if wanted.has(frame):
                return frame

    def open(self) -> None:
        """Connect; `read` does it by itself. Raises RequestNotFound for an unknown stream."""
        raise NotImplementedError

    def close(self) -> None:
        """Disconnect, for good; twice is fine. Later reads, and those that wait in other threads, say so."""
        raise NotImplementedError

    @property
    def lost(self) -> int:
        """Frames missing between those that were read: they came while we were too slow, or their transfer failed.

        `frame.info.lost` is how many are missing right before a frame, `frame.info.failed` how many of those failed.
        """
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<stream {self.name}>"

    def __iter__(self) -> Iterator[Frame]:
        while True:
            yield self.read()

    def __enter__(self: Self) -> Self:
        self.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


class LocalStream(Stream):
    """Frames where the hardware put them: read-only arrays, leased until the last reference is gone.

    At most `depth` frames are lent to us at a time (held, or waiting to be read); frames that come beyond that are
    lost to us. `newest`: frames that are followed by a newer one are skipped. After a change of mode the frames
    continue, in the new shape.
    """

    def __init__(
        self, folder: Path, wanted: Open, timeout: float | None, newest: bool = False, owner: Any = None
    ) -> None:
        self._connection: DataConnection | None = None
        self._timeout = time_limit(timeout)
        self._opening: DataConnection | None = None  # the manager has not answered on it yet
        self._folder = folder
        self._owner = owner  # the board, which this keeps alive
        self._wanted = wanted
        self.name = wanted.name
        self._newest = newest
        self._lost_before = 0
        self._ended: CmError | None = None

    def open(self) -> None:
        self._connected()

    def __del__(self) -> None:
        if self._connection is not None:  # dropped without being closed
            self.close()

    def end(self, because: CmError) -> None:
        """The board is closed; any later use raises `because`, and so does a call that waits in another thread."""
        self._ended = because
        if self._connection is not None:
            self._lost_before += self._connection.lost
        for connection in (self._opening, self._connection):
            if connection is not None:
                connection.close()
        self._connection = None

    def _connected(self) -> DataConnection:
        if self._ended is not None:
            raise self._ended
        return self._connection or self._opened()

    def _check(self) -> None:
        if self._ended is not None:
            raise self._ended from None

    def _opened(self) -> DataConnection:
        """Connect; the manager's refusal is raised here. If the stream is stopped just now, its frames come later."""
        from cm.client.data_connection import DataConnection  # imported here: only Linux has such sockets

        connection = self._opening = DataConnection(self._folder, self._wanted)
        try:
            self._check()  # an end() from here on finds the connection
            connection.set_timeout(at_least(self._timeout, _ANSWER))
            while connection.geometry is None and not connection.stopped:
                connection.receive()
            self._connection = connection
        except BlockingIOError:
            raise Timeout(f"stream {self.name!r}: the manager did not answer on its data socket") from None
        except Exception:
            self._check()  # closed by another thread
            raise
        finally:
            self._opening = None
            if self._connection is not connection:
                connection.close()
        return connection

    @property
    def geometry(self) -> Geometry | None:
        """The current shape, dtype and slots; None while the stream is stopped."""
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
        return self._connected().socket.fileno()

    def read(self, timeout: Limit = DEFAULT) -> Frame:
        connection = self._connected()
        limit = seconds(timeout, self._timeout)
        connection.set_timeout(limit)
        deadline = Deadline(limit)
        try:
            while (frame := connection.receive()) is None:
                connection.set_timeout(deadline.left)
            return self._latest(connection, frame) if self._newest else frame
        except BlockingIOError:
            raise Timeout(self.nothing(limit)) from None
        except ConnectionLost as error:
            raise self._ended or error from None  # closed by another thread

    def poll(self) -> Frame | None:
        """The next frame if there is one already; never waits."""
        connection = self._connected()
        try:
            while (frame := connection.take()) is None:
                pass
            return self._latest(connection, frame) if self._newest else frame
        except BlockingIOError:
            return None
        except ConnectionLost as error:
            raise self._ended or error from None

    def _latest(self, connection: DataConnection, frame: Frame) -> Frame:
        while True:
            try:
                newer = connection.take()
            except BlockingIOError:
                return frame
            if newer is not None:
                frame.release()
                frame = newer

    def nothing(self, limit: float | None) -> str:
        """Why nothing may have come, in a sentence."""
        text = f"stream {self.name!r} gave no frame within {limit or 0:g} s"
        geometry = self.geometry
        if geometry is None:
            return f"{text}: it is stopped"
        if self._connection and self._connection.held >= geometry.depth:
            return f"{text}: all {geometry.depth} frames that may be held are; keep copies, or ask for a larger depth"
        return text

    def close(self) -> None:
        if self._ended is None:
            self.end(closed(self.name))


class RemoteStream(Stream):
    """Frames over ZeroMQ; losses show in `sequence`."""

    def __init__(self, board: Caller, wanted: Wanted) -> None:
        self.name = wanted.name
        self._timeout = time_limit(wanted.timeout)
        self._board = board  # keeps the board alive
        self._reader: Reader = self._made(wanted)

    def _made(self, wanted: Wanted) -> Reader:
        return PublishedReader(wanted, lambda topic, depth: self._board.subscribe(topic, depth=depth))

    def _run(self, flow: Flow[_T]) -> _T:
        return self._board.run(flow)

    def open(self) -> None:
        self._run(self._reader.opening())

    @property
    def lost(self) -> int:
        return self._reader.lost

    def read(self, timeout: Limit = DEFAULT) -> Frame:
        return self._run(self._reader.reading(timeout))

    def close(self) -> None:
        self._reader.close()

    def __del__(self) -> None:
        self.close()


class NewestStream(RemoteStream):
    """Requests each frame when it is read, over a connection of its own: others are answered meanwhile."""

    def __init__(self, board: Caller, wanted: Wanted, connect: Callable[[], Link]) -> None:
        super().__init__(board, wanted)
        self._connect = connect
        self._link: Link | None = None

    def _made(self, wanted: Wanted) -> Reader:
        return NewestReader(wanted)

    def _run(self, flow: Flow[_T]) -> _T:
        link = self._link = self._link or self._connect()
        return link.run(flow)

    def close(self) -> None:
        super().close()
        if self._link is not None:
            self._link.close()
            self._link = None
