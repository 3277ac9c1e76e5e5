# SPDX-License-Identifier: Apache-2.0
"""A camera at the stream side of a DMA channel."""

from __future__ import annotations

from cm.loop import Loop
from cm.sim.faults import Faults
from cm.sim.hardware.camera import SHAPE, PhotoReel
from cm.sim.hardware.datapath import Datapath
from cm.sim.hardware.dma import Channel
from cm.sim.hardware.interrupts import InterruptWiring
from cm.sim.hardware.links import Link


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
