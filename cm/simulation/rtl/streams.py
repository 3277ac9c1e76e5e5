# SPDX-License-Identifier: Apache-2.0
"""DMA channels at the design's streams: packets into the logic and out of it, and a camera at its pins."""

from __future__ import annotations

from cm.loop import Loop
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.process import Op
from cm.simulation.rtl.running_design import SLOT, RunningDesign
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.camera import MAX_ZOOM
from cm.simulation.software.hardware.dma import Bytes, Channel, Transfer
from cm.simulation.software.hardware.links import Camera, Link
from cm.wire.lazy_numpy import np

MAX_PACKET = SLOT


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


def _line(channel: Channel, transfer: Transfer) -> int:
    """Bytes of a line, for a VDMA: its frames are lines on the stream too. 0: one packet."""
    return int(transfer.view.shape[1]) if channel.spec.vdma else 0


class NoLink(Link):
    """A channel that exists only because no schema names one: nothing is connected to it."""

    def _move(self) -> None:
        """Nothing moves."""


class IntakeLink(Link):
    """Stream to memory: fills the transfer at the head of the queue with the next packet.

    It comes out of the logic by itself, or after a picture of a sensor at the pins of the device has gone in. A
    picture begins when there is a buffer for a frame; the logic's output arrives whenever it is ready.
    """

    def __init__(
        self, loop: Loop, faults: Faults, running: RunningDesign, stream: int, channel: Channel,
        camera: Camera | None = None, sensor: int = 0,
    ) -> None:  # fmt: skip
        """`sensor`: the stream that the camera's pictures go to."""
        super().__init__(loop, faults)
        self._running, self._end, self._channel = running, End(running, stream), channel
        self._into: Transfer | None = None
        running.on_received[stream] = self._received
        self.camera, self._sensor = camera, End(running, sensor)
        self._exposes = False  # a picture is on its way into the logic
        if camera is not None:
            camera.kick = self.kick
            running.on_sent[sensor] = self._exposed

    def _move(self) -> None:
        if self._hangs(self._channel):
            return
        self._make_room()
        camera = self.camera
        if camera is None or not self._channel.queue or camera.credit == 0 or self._exposes:
            return
        if self._pace(camera.rate):
            self._exposes = self._sensor.send(camera.take(self._lens).reshape(-1))

    def _make_room(self) -> None:
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
        if into is not None and channel.queue and channel.queue[0] is into:
            self._store(channel, self._end.data(length), overflow)
            channel.kick()

    def _lens(self, name: str, default: int) -> int:
        """The signal of that name, or one whose name ends with it (``lens_focus``), if the region drives it."""
        value = self._running.output(self._channel.spec.region, name)
        return default if not value or value > MAX_ZOOM else value

    def _exposed(self) -> None:
        self._exposes = False
        self.kick()


class OutletLink(Link):
    """Memory to stream: one packet for each transfer, or each period of a cyclic one."""

    def __init__(self, loop: Loop, faults: Faults, running: RunningDesign, stream: int, channel: Channel) -> None:
        super().__init__(loop, faults)
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
        if self._failed(channel):
            self.kick()
        elif self._end.send(queue[0].data(), _line(channel, queue[0])):
            self._sending = queue[0]

    def _left(self) -> None:
        channel, sent = self._channel, self._sending
        self._sending = None
        if sent is not None and channel.queue and channel.queue[0] is sent:
            channel.complete(sent.period)
        self.kick()
