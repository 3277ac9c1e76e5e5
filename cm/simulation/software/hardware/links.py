# SPDX-License-Identifier: Apache-2.0
"""What is at the stream side of the DMA channels: a region's module between them, or a camera."""

from __future__ import annotations

import errno
import time
from collections import deque
from typing import TYPE_CHECKING

from cm.loop import Loop, Timer
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.camera import SHAPE, PhotoReel
from cm.simulation.software.hardware.datapath import Datapath
from cm.simulation.software.hardware.dma import Bytes, Channel
from cm.simulation.software.hardware.fastpath import FastPath
from cm.simulation.software.hardware.interrupts import InterruptWiring

if TYPE_CHECKING:
    import numpy as np
else:
    from cm.wire.lazy_numpy import np


_WAITING = 16  # packets that a model may have sent and that have not been taken


class Link:
    """The end of one or two channels; `kick` moves what can be moved."""

    def __init__(self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath) -> None:
        self._loop, self._faults, self._interrupts, self._path = loop, faults, interrupts, path
        self._soon = False
        self._timer: Timer | None = None
        self._due = 0.0
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

    def _deliver(self, channel: Channel, data: Bytes) -> None:
        """Put a packet into the buffer at the head of a stream-to-memory channel."""
        if self._faults.take("dma_error", channel.spec.name):
            channel.complete(0, -errno.EIO)
            return
        short = self._faults.take("short_packet", channel.spec.name)
        if short is not None:
            data = data[: short.value]
        stored = channel.queue[0].store(data)
        overflow = stored < len(data)
        channel.complete(stored, -errno.EIO if overflow else 0)
        self._path.count_frame()
        self._interrupts.packet_done(channel.spec.name, channel.spec.region)


class LoopLink(Link):
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
        return not (self._slow or self._faults.waiting or told) and self._path.flows and self._path.plain

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
        if self._faults.take("dma_error", source.spec.name):
            source.complete(0, -errno.EIO)
        else:
            result = self._path.process(self._path.frame(self._taken(transfer.data())), source.spec.name)
            if result is not None and sink.queue:
                self._deliver(sink, result)
            source.complete(transfer.period)
        super().kick()


class SinkLink(Link):
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
        failed = self._faults.take("dma_error", source.spec.name)
        if not failed:
            self._path.consume(self._path.frame(transfer.data()), source.spec.name)
        source.complete(0 if failed else transfer.period, -errno.EIO if failed else 0)
        self.kick()


class CameraLink(Link):
    """A camera before a region: a frame at its rate, while there is a buffer for it."""

    def __init__(
        self, loop: Loop, faults: Faults, interrupts: InterruptWiring, path: Datapath, sink: Channel, reel: PhotoReel,
        rate: float,
    ) -> None:  # fmt: skip
        super().__init__(loop, faults, interrupts, path)
        self._sink, self._reel, self._rate = sink, reel, rate
        self._credit: int | None = None  # frames that may still come; None: no limit

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
        self._credit = 0

    def step(self, frames: int) -> None:
        """Let that many more come, then pause."""
        self._credit = (self._credit or 0) + frames
        self.kick()

    def resume(self) -> None:
        """Frames come by themselves again."""
        self._credit = None
        self.kick()

    def _move(self) -> None:
        self._send(self._sink)
        if not self._sink.queue or not self._path.flows or self._credit == 0 or self._hangs(self._sink):
            return
        if self._path.fills(self._sink.spec.name):
            return
        if not self._pace(self._rate):
            return
        if self._credit is not None:
            self._credit -= 1
        picture = self._reel.take(self._shape(), self._path.register("focus", 1), self._path.register("zoom", 1))
        result = self._path.process(picture, self._sink.spec.name)
        if result is not None:
            self._deliver(self._sink, result)
        self.kick()

    def _shape(self) -> tuple[int, int]:
        shape = self._sink.spec.shape or SHAPE
        return (shape[0], shape[1]) if len(shape) > 1 else (1, shape[0])
