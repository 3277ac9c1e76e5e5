# SPDX-License-Identifier: Apache-2.0
"""A region from the point of view of the data that flows through it."""

from __future__ import annotations

import logging
import math

from cm.simulation.software.hardware.board_spec import ModuleSpec
from cm.simulation.software.hardware.dma import Bytes
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.models import Models, default
from cm.simulation.software.hardware.register_windows import Region
from cm.simulation.software.hardware.running_models import RunningModels
from cm.wire.lazy_numpy import np

_log = logging.getLogger(__name__)


class Datapath:
    """A region as data sees it: its module's model, garbage without one, or nothing at all."""

    def __init__(
        self,
        fabric: Fabric,
        models: Models,
        running: RunningModels,
        region: str | None,
        shape: tuple[int, ...] | None,
    ) -> None:
        self._fabric, self._models, self._running = fabric, models, running
        self._name = region if region in fabric.regions else None
        self._failed: ModuleSpec | None = None  # reported once
        self._region: Region | None = fabric.regions.get(region) if region else None
        self._width = shape[-1] if shape and len(shape) == 1 else math.prod(shape[1:]) if shape else 0

    @property
    def flows(self) -> bool:
        """False while the region is decoupled."""
        return self._region is None or not self._region.decoupled

    def plain(self, stream: str) -> bool:
        """Whether data leaves as it enters, and none of it has to be kept."""
        if self._fabric.cell("frame_count", self._name) is not None:
            return False
        if self._region is None:
            return self._running.blocks.plain(stream)
        module = self._region.module
        return self._region.running and module is not None and self._models.get(module.model) is default

    def register(self, name: str, default: int) -> int:
        """A register that the source itself obeys, or `default` if the schema has none."""
        cell = self._fabric.cell(name, self._name)
        return default if cell is None else cell.value

    def count_frame(self) -> None:
        """Count in the register `frame_count`, if there is one."""
        cell = self._fabric.cell("frame_count", self._name)
        if cell is not None:
            cell.value += 1

    def frame(self, data: Bytes) -> Bytes:
        """Bytes as lines of the stream's width; as one line if they are not a whole number of lines."""
        whole = self._width and len(data) % self._width == 0
        return data.reshape(-1, self._width) if whole else data.reshape(1, -1)

    def fills(self, stream: str) -> bool:
        """Whether the region's model sends on a stream by itself."""
        return self._running.fills(self._name, stream)

    def consume(self, frame: Bytes, stream: str) -> None:
        """A frame enters the region on a stream without an output: for models with a state."""
        if self._region is None or self._running.of(self._name) is not None:
            self.process(frame, stream)

    def _by_state(self, frame: Bytes, stream: str) -> Bytes | None:
        model = self._running.of(self._name)
        if model is None:  # it failed
            return self._fabric.noise(frame.size)
        left = self._running.guarded(model, model.frame, stream, frame)
        return None if left is None else np.ascontiguousarray(left).reshape(-1).view(np.uint8)

    def process(self, frame: Bytes, stream: str) -> Bytes | None:
        """The bytes that leave the region when a frame, (height, width), enters it on a stream; None: none do."""
        if self._region is None:
            led, left = self._running.blocks.through(stream, frame)
            return left if led else frame.reshape(-1)
        if not self._region.running or self._region.module is None:
            return self._fabric.noise(frame.size)
        frame = frame.view()
        frame.flags.writeable = False
        model = self._models.get(self._region.module.model)
        if isinstance(model, type):
            return self._by_state(frame, stream)
        try:
            result = model(frame, self._fabric.registers(self._name))
            return np.ascontiguousarray(result).reshape(-1).view(np.uint8)
        except Exception:  # noqa: BLE001 - a user's model must not end the board
            if self._failed is not self._region.module:
                self._failed = self._region.module
                _log.exception("the model of %s failed; garbage leaves the region", self._region.module.name)
            return self._fabric.noise(frame.size)
