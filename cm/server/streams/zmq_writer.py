# SPDX-License-Identifier: Apache-2.0
"""Passes frames that clients write over ZeroMQ to the hardware."""

from __future__ import annotations

import itertools
import os
import time
from collections import deque

from cm.device.data_plane import Plane
from cm.errors import Busy, CmError, InvalidRequest, Timeout
from cm.server.loop import Loop, Timer
from cm.server.streams.policy import StreamStopped
from cm.server.streams.settings import frame_bytes
from cm.server.streams.stream import Done, Frame, OpenStream
from cm.server.streams.zmq_client import ZmqClient, line_slices
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor

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
        self._check_size(memoryview(data).nbytes)
        if len(self._waiting) >= _WAITING:
            name = self._stream.stream.name
            raise Busy(f"stream {name!r}: {_WAITING} frames wait already; the hardware takes none")
        self._used_at = time.monotonic()
        self._waiting.append((data, done))
        self._send()

    def _check_size(self, size: int) -> None:
        s, frame = self._stream.stream, frame_bytes(self._stream.stream)
        if frame and size != frame:
            text = f"{'×'.join(map(str, s.shape or ()))} {s.dtype}"
            raise InvalidRequest(f"stream {s.name!r} takes frames of {text}, {frame} bytes; this one has {size}")
        if not 0 < size <= self._stream.setup.length:
            raise InvalidRequest(
                f"stream {s.name!r} takes 1 to {self._stream.setup.length} bytes; this frame has {size}"
            )

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

    def _take(self, packet: Descriptor) -> None:
        if packet.kind == packets.DONE:
            self._done(packet)
        if packet.kind == packets.GRANT or (packet.kind == packets.DONE and not self._keeps(packet)):
            self._free.append(packet)
            self._send()

    def _keeps(self, packet: Descriptor) -> bool:
        """Whether the hardware repeats the frame, so that its slot is not free yet."""
        return self._stream.setup.cyclic and packet.offset == 0

    def _done(self, packet: Descriptor) -> None:
        done, timer = self._under_way.pop(packet.slot)
        timer.cancel()
        self._used_at = time.monotonic()
        if packet.offset:
            done(_failure(self._stream.stream.name, packet.offset))
        else:
            done(Frame(self._stream.info(packet), memoryview(b"")))

    def close(self, error: CmError | OSError | None = None) -> None:
        super().close()
        stopped = error or StreamStopped(f"stream {self._stream.stream.name!r} was stopped before the frame was taken")
        for done, timer in self._under_way.values():
            timer.cancel()
            done(stopped)
        for _, done in self._waiting:
            done(stopped)
        self._under_way.clear()
        self._waiting.clear()


def _failure(stream: str, number: int) -> CmError:
    return TransferFailed(f"stream {stream!r}: the DMA reported {os.strerror(number)}")
