# SPDX-License-Identifier: Apache-2.0
"""Streams over ZeroMQ: the manager as a client of its own data plane, on behalf of ZeroMQ clients.

It is a client like any other, connected by a socket pair: one that reads for subscribers and single reads, and one that
writes.
"""

from __future__ import annotations

import itertools
import os
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator

from cm.device.data_plane import Plane, StreamSetup
from cm.errors import Busy, CmError, InvalidRequest, Timeout
from cm.frozen import replace
from cm.loop import Timer
from cm.server.sockets import Loop
from cm.server.streams.channel_setup import frame_bytes
from cm.server.streams.lifecycle import StreamStopped
from cm.server.streams.stream import Done, Frame, OpenStream
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import DESCRIPTOR, Descriptor

_LINGER = 2.0  # seconds that a stream stays open after a single read or write


class ZmqClient:
    """A client of the plane in this process."""

    def __init__(self, loop: Loop, plane: Plane, opened: OpenStream, depth: int) -> None:
        self._loop, self._plane, self._stream = loop, plane, opened
        self._used_at = 0.0
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        self._socket = ours
        self.client = plane.adopt(theirs.detach())
        try:
            opened.machine.join(self.client, depth)
        except BaseException:
            plane.drop(self.client)
            ours.close()
            raise
        loop.add(ours.fileno(), self._readable)

    @property
    def working(self) -> bool:
        """Whether a request is waiting now."""
        raise NotImplementedError

    @property
    def busy(self) -> bool:
        """Whether a request is waiting, or was a moment ago."""
        return self.working or time.monotonic() < self._used_at + _LINGER

    def close(self, error: Exception | None = None) -> None:  # noqa: ARG002 (for subclasses)
        """Disconnect; waiting requests get the error, or are told that the stream was stopped."""
        self._loop.remove(self._socket.fileno())
        self._plane.drop(self.client)
        self._stream.machine.left(self.client)
        self._socket.close()

    def _readable(self) -> None:
        try:
            packet = self._socket.recv(packets.PACKET_MAX)  # descriptors of memory that come with it are closed
        except BlockingIOError:
            return
        if len(packet) >= DESCRIPTOR.size:
            self._take_packet(Descriptor(*DESCRIPTOR.unpack_from(packet)))

    def _take_packet(self, packet: Descriptor) -> None:
        raise NotImplementedError


def line_slices(setup: StreamSetup) -> Iterator[slice]:
    """The bytes of each line of a video frame in its slot."""
    for begin in range(0, setup.lines * setup.stride, setup.stride):
        yield slice(begin, begin + setup.line_bytes)


_READ_DEPTH = 2


class ZmqReader(ZmqClient):
    """Passes frames to subscribers and to single reads."""

    def __init__(self, loop: Loop, plane: Plane, opened: OpenStream, deliver: Callable[[Frame], None]) -> None:
        self._deliver = deliver
        self._readers: deque[tuple[Done, Timer]] = deque()
        self._generation = self._failed = 0
        super().__init__(loop, plane, opened, _READ_DEPTH)

    @property
    def working(self) -> bool:
        """Whether a request is waiting for a frame."""
        return bool(self._readers)

    def read_once(self, timeout: float, done: Done) -> None:
        """Pass a copy of the next frame to `done`, or a Timeout after `timeout` seconds."""
        entry: list[tuple[Done, Timer]] = []

        def expired() -> None:
            if entry[0] in self._readers:
                self._readers.remove(entry[0])
                done(Timeout(f"stream {self._stream.stream.name!r} gave no frame within {timeout:g} s"))

        entry.append((done, self._loop.call_later(timeout, expired)))
        self._readers.append(entry[0])
        self._used_at = time.monotonic()

    def _take_packet(self, packet: Descriptor) -> None:
        if packet.kind == packets.GENERATION:
            self._generation = packet.sequence
        if packet.kind == packets.FAILED:
            self._failed = packet.sequence
        if packet.kind != packets.FRAME:
            return
        try:
            self._hand_on(packet)
        finally:
            self._socket.send(packet._replace(kind=packets.RELEASE).pack())

    def _hand_on(self, packet: Descriptor) -> None:
        slot = self._stream.slots[packet.slot]
        slot.sync_begin(write=False)
        try:
            frame = Frame(self._stream.info(packet, self._generation, self._failed), self._bytes(packet))
            readers, self._readers = self._readers, deque()
            kept = replace(frame, data=memoryview(bytes(frame.data))) if readers else frame  # one copy for all reads
            for done, timer in readers:
                timer.cancel()
                done(kept)
            self._deliver(frame)
        finally:
            slot.sync_end(write=False)

    def _bytes(self, packet: Descriptor) -> memoryview:
        """The frame's bytes without gaps; copied only if its lines are apart."""
        setup, slot = self._stream.setup, self._stream.slots[packet.slot]
        view = slot.memoryview(writable=False)
        if setup.lines and setup.stride != setup.line_bytes:
            return memoryview(b"".join(view[line] for line in line_slices(setup)))[: packet.length]
        return view[packet.offset : packet.offset + packet.length]

    def close(self, error: Exception | None = None) -> None:
        super().close()
        readers, self._readers = self._readers, deque()
        for done, timer in readers:
            timer.cancel()
            done(error or StreamStopped(f"stream {self._stream.stream.name!r} was stopped before a frame came"))


_WRITE_DEPTH = 4
_WAITING = 32  # writes that may wait for a slot
_WRITE_TIMEOUT = 5.0  # seconds for the hardware to take a written frame


class TransferFailed(CmError):
    """The DMA reported an error."""

    code = "transfer_failed"


class ZmqWriter(ZmqClient):
    """Passes written frames to the hardware, one at a time."""

    def __init__(self, loop: Loop, plane: Plane, opened: OpenStream) -> None:
        self._free: deque[Descriptor] = deque()
        self._under_way: dict[int, tuple[Done, Timer]] = {}
        self._waiting: deque[tuple[bytes | memoryview, Done]] = deque()
        self._numbers = itertools.count()
        super().__init__(loop, plane, opened, min(_WRITE_DEPTH, max(2, opened.stream.slots)))

    @property
    def working(self) -> bool:
        """Whether a frame is waiting or being transferred."""
        return bool(self._under_way or self._waiting)

    def write(self, data: bytes | memoryview, done: Done) -> None:
        """Send a frame. Raises InvalidRequest for a wrong size, and Busy if too many frames are waiting."""
        s, size = self._stream.stream, memoryview(data).nbytes
        frame = frame_bytes(s)
        if frame and size != frame:
            text = f"{'×'.join(map(str, s.shape or ()))} {s.dtype}"
            raise InvalidRequest(f"stream {s.name!r} takes frames of {text}, {frame} bytes; this one has {size}")
        if not 0 < size <= self._stream.setup.length:
            raise InvalidRequest(
                f"stream {s.name!r} takes 1 to {self._stream.setup.length} bytes; this frame has {size}"
            )
        if len(self._waiting) >= _WAITING:
            raise Busy(f"stream {s.name!r}: {_WAITING} frames wait already; the hardware takes none")
        self._used_at = time.monotonic()
        self._waiting.append((data, done))
        self._send()

    def _send(self) -> None:
        while self._free and self._waiting:
            grant = self._free.popleft()
            data, done = self._waiting.popleft()
            length = self._fill(grant.slot, memoryview(data).cast("B"))
            timer = self._loop.call_later(_WRITE_TIMEOUT, lambda number=grant.slot: self._stuck(number))  # type: ignore[misc]
            self._under_way[grant.slot] = (done, timer)
            submit = grant._replace(kind=packets.SUBMIT, offset=0, length=length, sequence=next(self._numbers))
            self._socket.send(submit.pack())

    def _fill(self, number: int, view: memoryview) -> int:
        """Copy a frame into a slot; return the length of the transfer in bytes."""
        setup, slot = self._stream.setup, self._stream.slots[number]
        slot.sync_begin(write=True)
        try:
            memory = slot.memoryview()
            if setup.lines and setup.stride != setup.line_bytes:
                for at, line in enumerate(line_slices(setup)):
                    memory[line] = view[at * setup.line_bytes : (at + 1) * setup.line_bytes]
                return setup.length
            memory[: view.nbytes] = view
            return view.nbytes
        finally:
            slot.sync_end(write=True)

    def _stuck(self, number: int) -> None:
        """The slot stays with the hardware; only the caller is told."""
        if number in self._under_way:
            done, timer = self._under_way[number]
            self._under_way[number] = (lambda _: None, timer)
            done(
                Timeout(
                    f"stream {self._stream.stream.name!r}: the hardware took no data for {_WRITE_TIMEOUT:.0f} s; "
                    "is anything reading the output, and is the region coupled?"
                )
            )

    def _take_packet(self, packet: Descriptor) -> None:
        if packet.kind == packets.DONE:
            self._complete_write(packet)
        repeated = self._stream.setup.cyclic and packet.offset == 0  # by the hardware, so that its slot is not free yet
        if packet.kind == packets.GRANT or (packet.kind == packets.DONE and not repeated):
            self._free.append(packet)
            self._send()

    def _complete_write(self, packet: Descriptor) -> None:
        done, timer = self._under_way.pop(packet.slot)
        timer.cancel()
        self._used_at = time.monotonic()
        if packet.offset:
            name, why = self._stream.stream.name, os.strerror(packet.offset)
            done(TransferFailed(f"stream {name!r}: the DMA reported {why}"))
        else:
            done(Frame(self._stream.info(packet), memoryview(b"")))

    def close(self, error: Exception | None = None) -> None:
        super().close()
        stopped = error or StreamStopped(f"stream {self._stream.stream.name!r} was stopped before the frame was taken")
        for done, timer in self._under_way.values():
            timer.cancel()
            done(stopped)
        for _, done in self._waiting:
            done(stopped)
        self._under_way.clear()
        self._waiting.clear()
