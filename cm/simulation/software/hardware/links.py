# SPDX-License-Identifier: Apache-2.0
"""What is at the stream side of the DMA channels: a region's module between them, or a camera."""

from __future__ import annotations

import errno
import time
from collections import deque
from collections.abc import Callable, Sequence

from cm.loop import Loop, Timer
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.camera import SHAPE, Photo, PhotoReel
from cm.simulation.software.hardware.datapath import Datapath
from cm.simulation.software.hardware.dma import Bytes, Channel
from cm.simulation.software.hardware.dma_fastpath import FastPath
from cm.simulation.software.hardware.interrupts import InterruptWiring
from cm.wire.lazy_numpy import np

_WAITING = 16  # packets that a model may have sent and that have not been taken


class Camera:
    """A sensor before a stream: pictures at a rate (frames a second; 0: as they are taken), held and let go by hand."""

    def __init__(self, reel: PhotoReel, rate: float, shape: Sequence[int] | None) -> None:
        self._reel, self.rate = reel, rate
        rows, columns = (shape if len(shape) > 1 else (1, *shape))[:2] if shape else SHAPE
        self._shape = rows, columns
        self.credit: int | None = None  # frames that may still come; None: no limit
        self.kick: Callable[[], None] = lambda: None

    @property
    def frames(self) -> int:
        """Frames taken so far."""
        return self._reel.taken

    @property
    def photo(self) -> int:
        """Index of the photo that the next frame shows."""
        return self._reel.index

    def pause(self) -> None:
        """No more frames until `step` or `resume`."""
        self.credit = 0

    def step(self, frames: int) -> None:
        """Let that many more come, then pause."""
        self.credit = (self.credit or 0) + frames
        self.kick()

    def resume(self) -> None:
        """Frames come by themselves again."""
        self.credit = None
        self.kick()

    def take(self, register: Callable[[str, int], int]) -> Photo:
        """The next picture; `register`: what the lens is told, by name, and what it does without."""
        if self.credit is not None:
            self.credit -= 1
        return self._reel.take(self._shape, register("focus", 1), register("zoom", 1))


class Link:
    """The end of one or two channels; `kick` moves what can be moved."""

    camera: Camera | None = None

    def __init__(self, loop: Loop, faults: Faults) -> None:
        self._loop, self._faults = loop, faults
        self._soon = False
        self._timer: Timer | None = None
        self._due = 0.0

    def offer(self, name: str, data: Bytes) -> bool:  # noqa: ARG002 - no model is here
        """Let a packet leave on a channel when it has room; False if it is lost."""
        return False

    def kick(self) -> None:
        """Something changed: look again before the loop waits."""
        if not self._soon:
            self._soon = True
            self._loop.call_soon(self._wake)

    @property
    def lent(self) -> int:
        """How often the channels were lent to a faster server."""
        return 0

    def take_back(self) -> None:
        """Take the channels back, if they are lent to a faster server."""

    def close(self) -> None:
        """End what runs beside us."""

    def _wake(self) -> None:
        self._soon = False
        self._move()

    def _move(self) -> None:
        raise NotImplementedError

    def _hangs(self, channel: Channel) -> bool:
        return self._faults.take("hang", channel.spec.name) is not None

    def _pace(self, rate: float) -> bool:
        """Whether it is time for the next frame; if not, it calls again when it is."""
        if rate <= 0:
            return True
        now = time.monotonic()
        if now < self._due:
            if self._timer is None:
                self._timer = self._loop.call_at(self._due, self._tick)
            return False
        late = now - self._due > 1 / rate  # in that case the rhythm starts anew
        self._due = (now if late else self._due) + 1 / rate
        return True

    def _tick(self) -> None:
        self._timer = None
        self._wake()

    def _failed(self, channel: Channel) -> bool:
        """Whether a fault was ordered for the transfer at the head, which ends with it."""
        failed = self._faults.take("dma_error", channel.spec.name) is not None
        if failed:
            channel.complete(0, -errno.EIO)
        return failed

    def _store(self, channel: Channel, data: Bytes, cut: bool = False) -> bool:
        """Put a packet into the buffer at the head of a stream-to-memory channel; `cut`: more came than there is."""
        if self._failed(channel):
            return False
        short = self._faults.take("short_packet", channel.spec.name)
        if short is not None:
            data = data[: short.value]
        stored = channel.queue[0].store(data)
        channel.complete(stored, -errno.EIO if cut or stored < len(data) else 0)
        return True


class ModelLink(Link):
    """A link to a region whose module is a model in software."""

    def __init__(self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath) -> None:
        super().__init__(loop, faults)
        self._interrupts, self._path = interrupts, path
        self._sent: deque[tuple[str, Bytes]] = deque()  # by a model, on its own initiative

    def offer(self, name: str, data: Bytes) -> bool:
        """Let a packet leave on a channel when it has room; False if it is lost."""
        if len(self._sent) >= _WAITING:
            return False
        self._sent.append((name, data.copy()))
        self.kick()
        return True

    def _send(self, sink: Channel) -> None:
        while self._sent and sink.queue and self._path.flows:
            self._deliver(sink, self._sent.popleft()[1])

    def _deliver(self, channel: Channel, data: Bytes) -> None:
        if self._store(channel, data):
            self._path.count_frame()
            self._interrupts.packet_done(channel.spec.name, channel.spec.region)


class LoopLink(ModelLink):
    """Memory to stream, through the region, and back: a packet waits until there is room for it."""

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, source: Channel, sink: Channel
    ) -> None:
        super().__init__(loop, faults, interrupts, path)
        self._source, self._sink = source, sink
        self._inside: Bytes | None = None
        self._fast = FastPath(loop, source, sink, self._returned)
        self._slow = False  # something waits that only this process can serve

    def kick(self) -> None:
        """Something changed: look again before the loop waits, after taking the channels back."""
        self._slow = False
        self.take_back()
        super().kick()

    @property
    def lent(self) -> int:
        """How often the channels were lent to the thread of the fast path."""
        return self._fast.lent

    def take_back(self) -> None:
        """Have the channels here."""
        self._fast.take_back()

    def close(self) -> None:
        """End what runs beside us."""
        self._fast.close()

    def _returned(self) -> None:
        self._slow = True
        super().kick()

    @property
    def _plain(self) -> bool:
        """Whether data is only passed on, without an interrupt."""
        told = self._interrupts.of_packets(self._sink.spec.name, self._sink.spec.region)
        return (
            not (self._slow or self._faults.waiting or told)
            and self._path.flows
            and self._path.plain(self._source.spec.name)
        )

    def _taken(self, data: Bytes) -> Bytes:
        """A packet on its way through the PL: its bytes have left the memory that they came from."""
        if self._inside is None or len(self._inside) < len(data):
            self._inside = np.empty(len(data), np.uint8)
        inside = self._inside[: len(data)]
        np.copyto(inside, data)
        return inside

    def _move(self) -> None:
        source, sink = self._source, self._sink
        if self._plain and self._fast.lend():
            return
        self._send(sink)
        fills = self._path.fills(sink.spec.name)  # in that case what comes in need not leave
        if not source.queue or not (sink.queue or fills) or not self._path.flows:
            return
        if self._hangs(source) or self._hangs(sink):
            return
        transfer = source.queue[0]
        if transfer.cyclic and not self._pace(source.spec.rate):
            return
        if not self._failed(source):
            result = self._path.process(self._path.frame(self._taken(transfer.data())), source.spec.name)
            if result is not None and sink.queue:
                self._deliver(sink, result)
            source.complete(transfer.period)
        super().kick()


class SinkLink(ModelLink):
    """Memory to stream, with nothing behind it: frames are consumed."""

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, source: Channel
    ) -> None:
        super().__init__(loop, faults, interrupts, path)
        self._source = source

    def _move(self) -> None:
        source = self._source
        if not source.queue or not self._path.flows or self._hangs(source):
            return
        transfer = source.queue[0]
        if transfer.cyclic and not self._pace(source.spec.rate):
            return
        if not self._failed(source):
            self._path.consume(self._path.frame(transfer.data()), source.spec.name)
            source.complete(transfer.period)
        self.kick()


class SourceLink(ModelLink):
    """Stream to memory, with nothing before it but what models send."""

    def __init__(self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, sink: Channel) -> None:
        super().__init__(loop, faults, interrupts, path)
        self._sink = sink

    def _move(self) -> None:
        self._send(self._sink)


class CameraLink(ModelLink):
    """A camera before a region: a frame at its rate, while there is a buffer for it."""

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, sink: Channel, camera: Camera
    ) -> None:
        super().__init__(loop, faults, interrupts, path)
        self._sink, self.camera = sink, camera
        camera.kick = self.kick

    def _move(self) -> None:
        camera, path, sink = self.camera, self._path, self._sink
        self._send(sink)
        if camera is None or not sink.queue or not path.flows or camera.credit == 0 or self._hangs(sink):
            return
        if path.fills(sink.spec.name) or not self._pace(camera.rate):
            return
        result = path.process(camera.take(path.register), sink.spec.name)
        if result is not None:
            self._deliver(sink, result)
        self.kick()
