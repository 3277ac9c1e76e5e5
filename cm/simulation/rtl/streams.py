# SPDX-License-Identifier: Apache-2.0
"""DMA channels at the design's streams: packets into the logic and out of it, and a camera at its pins."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from cm.loop import Loop
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.process import Op
from cm.simulation.rtl.running_design import SLOT, RunningDesign
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.camera import MAX_ZOOM, PhotoReel
from cm.simulation.software.hardware.datapath import Datapath
from cm.simulation.software.hardware.dma import Bytes, Channel, Transfer
from cm.simulation.software.hardware.interrupts import InterruptWiring
from cm.simulation.software.hardware.links import CameraLink, Link

if TYPE_CHECKING:
    import numpy as np
else:
    from cm.wire.lazy_numpy import np

MAX_PACKET = SLOT


class OpticalPath(Datapath):
    """The signals that the design drives to the camera's lens. Nothing else passes here."""

    running: RunningDesign

    @property
    def flows(self) -> bool:
        """Always true: the logic itself controls the flow."""
        return True

    def register(self, name: str, default: int) -> int:
        """The signal of that name, or one whose name ends with it (``lens_focus``), if the region drives it."""
        value = self.running.output(self._name, name)
        return default if not value or value > MAX_ZOOM else value


class End:
    """A stream of the design in the arena: at most one packet is under way."""

    def __init__(self, running: RunningDesign, stream: int) -> None:
        self._running, self._stream = running, stream
        self._offset = (1 + stream) * SLOT

    def send(self, data: Bytes, line: int = 0) -> bool:
        """Begin to send a packet, or a frame of lines of so many bytes; False where the logic is gone."""
        length = len(data)
        target = np.frombuffer(self._running.process.arena, np.uint8, length, self._offset)
        np.copyto(target, data)
        return self._ask(Op.SEND, length, line)

    def receive(self, room: int, line: int = 0) -> bool:
        """Have room for a packet, or for a frame of lines; False where the logic is gone."""
        return self._ask(Op.RECEIVE, room, line)

    def cancel(self) -> None:
        """End the transfer that is under way."""
        self._ask(Op.CANCEL, 0)

    def data(self, length: int) -> Bytes:
        """What was received, until the next packet."""
        return np.frombuffer(self._running.process.arena, np.uint8, length, self._offset)

    def _ask(self, op: Op, length: int, line: int = 0) -> bool:
        try:
            return self._running.ask(op, self._stream, self._offset, length, line).a == 0
        except RtlError:
            return False


class Intake:
    """Stream to memory: fills the transfer at the head of the queue with the next packet."""

    def __init__(self, running: RunningDesign, stream: int, channel: Channel, faults: Faults) -> None:
        self._end, self._channel, self._faults = End(running, stream), channel, faults
        self._into: Transfer | None = None
        running.on_received[stream] = self._received

    def move(self) -> None:
        """Give the logic room if there is some; take it back if the transfer was cancelled."""
        queue = self._channel.queue
        if self._into is not None and (not queue or queue[0] is not self._into):
            self._end.cancel()
            self._into = None
        if queue and self._into is None:
            room = min(queue[0].period, MAX_PACKET)
            if self._end.receive(room, _line(self._channel, queue[0])):
                self._into = queue[0]

    def _received(self, length: int, overflow: bool) -> None:
        channel, into = self._channel, self._into
        self._into = None
        if into is None or not channel.queue or channel.queue[0] is not into:
            return
        if self._faults.take("dma_error", channel.spec.name):
            channel.complete(0, -errno.EIO)
        else:
            short = self._faults.take("short_packet", channel.spec.name)
            data = self._end.data(length if short is None else min(length, short.value))
            channel.complete(into.store(data), -errno.EIO if overflow else 0)
        channel.kick()


def _line(channel: Channel, transfer: Transfer) -> int:
    """Bytes of a line, for a VDMA: its frames are lines on the stream too. 0: one packet."""
    return int(transfer.view.shape[1]) if channel.spec.vdma else 0


class NoLink(Link):
    """A channel that exists only because no schema names one: nothing is connected to it."""

    def _move(self) -> None:
        """Nothing moves."""


class IntakeLink(Link):
    """A stream that comes out of the logic by itself."""

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, intake: Intake, channel: Channel
    ) -> None:
        super().__init__(loop, faults, interrupts, path)
        self._intake, self._channel = intake, channel

    def _move(self) -> None:
        if not self._hangs(self._channel):
            self._intake.move()


class OutletLink(Link):
    """Memory to stream: one packet for each transfer, or each period of a cyclic one."""

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, running: RunningDesign,
        stream: int, channel: Channel,
    ) -> None:  # fmt: skip
        super().__init__(loop, faults, interrupts, path)
        self._end, self._channel = End(running, stream), channel
        self._sending: Transfer | None = None
        running.on_sent[stream] = self._left

    def _move(self) -> None:
        channel, queue = self._channel, self._channel.queue
        if self._sending is not None and (not queue or queue[0] is not self._sending):
            self._end.cancel()
            self._sending = None
        if not queue or self._sending is not None or self._hangs(channel):
            return
        if queue[0].cyclic and not self._pace(channel.spec.rate):
            return
        if self._faults.take("dma_error", channel.spec.name):
            channel.complete(0, -errno.EIO)
            self.kick()
        elif self._end.send(queue[0].data(), _line(channel, queue[0])):
            self._sending = queue[0]

    def _left(self) -> None:
        channel, sent = self._channel, self._sending
        self._sending = None
        if sent is not None and channel.queue and channel.queue[0] is sent:
            channel.complete(sent.period)
        self.kick()


class RtlCameraLink(CameraLink):
    """A sensor at the pins of the device, and the region's stream to memory behind it.

    A picture begins when there is a buffer for a frame; the logic's output arrives whenever it is ready.
    """

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, sink: Channel, reel: PhotoReel,
        rate: float, intake: Intake, running: RunningDesign, stream: int,
    ) -> None:  # fmt: skip
        super().__init__(loop, faults, interrupts, path, sink, reel, rate)
        self._intake, self._sensor = intake, End(running, stream)
        self._exposes = False  # a picture is on its way into the logic
        running.on_sent[stream] = self._exposed

    def _move(self) -> None:
        if self._hangs(self._sink):
            return
        self._intake.move()
        if not self._sink.queue or self._credit == 0 or self._exposes or not self._pace(self._rate):
            return
        if self._credit is not None:
            self._credit -= 1
        picture = self._reel.take(self._shape(), self._path.register("focus", 1), self._path.register("zoom", 1))
        self._exposes = self._sensor.send(picture.reshape(-1))

    def _exposed(self) -> None:
        self._exposes = False
        self.kick()
