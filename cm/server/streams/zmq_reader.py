# SPDX-License-Identifier: Apache-2.0
"""Passes a stream's frames to its ZeroMQ subscribers and to single reads."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from cm.device.data_plane import Plane
from cm.errors import CmError, Timeout
from cm.server.loop import Loop, Timer
from cm.server.streams.policy import StreamStopped
from cm.server.streams.stream import Done, Frame, OpenStream
from cm.server.streams.zmq_client import ZmqClient, line_slices
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor

_READ_DEPTH = 2


class ZmqReader(ZmqClient):
    """Passes frames to subscribers and to single reads."""

    def __init__(self, loop: Loop, plane: Plane, opened: OpenStream, deliver: Callable[[Frame], None]) -> None:
        self._deliver = deliver
        self._readers: deque[tuple[Done, Timer]] = deque()
        self._generation = 0
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

    def _take(self, packet: Descriptor) -> None:
        if packet.kind == packets.GENERATION:
            self._generation = packet.sequence
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
            frame = Frame(self._stream.info(packet, self._generation), self._bytes(packet))
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

    def close(self, error: CmError | OSError | None = None) -> None:
        super().close()
        readers, self._readers = self._readers, deque()
        for done, timer in readers:
            timer.cancel()
            done(error or StreamStopped(f"stream {self._stream.stream.name!r} was stopped before a frame came"))
