# SPDX-License-Identifier: Apache-2.0
"""Running models with state: made when a module has been loaded, ended when its region is loaded again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

from cm.loop import Loop
from cm.simulation.software.errors import SimError
from cm.simulation.software.hardware.dma import Channel
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.interrupts import InterruptWiring
from cm.simulation.software.hardware.models import Model, Models
from cm.simulation.software.hardware.register_windows import Region, Window
from cm.simulation.software.hardware.running_blocks import RunningBlocks, array
from cm.simulation.software.transport.buffers import DmaMemory
from cm.wire.lazy_numpy import NDArray, np

_log = logging.getLogger(__name__)


class Outlet(Protocol):
    """The stream side of a channel."""

    def offer(self, name: str, data: NDArray[np.uint8]) -> bool:
        """Let a packet leave when there is room; False if it is lost."""


class RunningModels:
    """The models of all regions whose modules have such a model. A defect of a model is logged, and ends it."""

    def __init__(
        self, loop: Loop, fabric: Fabric, models: Models, interrupts: InterruptWiring, memory: DmaMemory
    ) -> None:
        self._loop, self._fabric, self._models = loop, fabric, models
        self._interrupts, self._memory = interrupts, memory
        self._running: dict[str, Model] = {}
        self.blocks = RunningBlocks(fabric, models, lambda: _Place(self), self.guarded)
        self.links: Mapping[str, Outlet] = {}
        self.channels: Mapping[str, Channel] = {}
        fabric.loaded = self._loaded

    def of(self, region: str | None) -> Model | None:
        """The model that runs in a region."""
        return self._running.get(region) if region else None

    def runs(self, model: Model) -> bool:
        """Whether it does still."""
        return model in self._running.values() or self.blocks.has(model)

    def fills(self, region: str | None, stream: str) -> bool:
        """Whether the model in a region sends on a stream by itself."""
        model = self.of(region)
        return model is not None and stream in model.outputs

    def written(self, window: Window, offset: int, length: int) -> None:
        """The bus wrote these bytes: tell the models whose registers they are."""
        if not self._running:
            return
        seen = {id(cell): cell for at in range(offset, offset + length) if (cell := window.cell_at(at)) is not None}
        for cell in seen.values():
            model = self.of(cell.region.name if cell.region else None)
            for told in [model] if model is not None else self._of_static(cell.region):
                self.guarded(told, told.written, cell.register.name, cell.value)

    def _of_static(self, region: Region | None) -> Iterable[Model]:
        return list(self._running.values()) if region is None else ()

    def guarded(self, model: Model, call: Callable[..., Any], *arguments: Any) -> Any:
        """The model's result; a model that fails is stopped, and the board goes on."""
        try:
            return call(*arguments)
        except Exception:  # noqa: BLE001 - a user's model must not end the board
            _log.exception("the model %s failed, and runs no more", type(model).__name__)
            self._running = {name: one for name, one in self._running.items() if one is not model}
            self.blocks.forget(model)
            return None

    def _loaded(self, region: Region) -> None:
        before = self._running.pop(region.name, None)
        if before is not None:
            self.guarded(before, before.stop)
        kind = self._models.get(region.module.model) if region.module is not None else None
        if isinstance(kind, type) and issubclass(kind, Model):
            self._start(region, kind)

    def _start(self, region: Region, kind: type[Model]) -> None:
        place = _Place(self)
        try:
            model = kind(self._fabric.registers(region.name), _arrays(self._fabric, region), place)
        except Exception:  # noqa: BLE001 - as above
            _log.exception("the model %s could not be started", kind.__name__)
            return
        place.model = self._running[region.name] = model

    def later(self, place: _Place, seconds: float, call: Callable[[], object]) -> None:
        """Make a call that a model asked for, if it still runs."""

        def due() -> None:
            if place.model is not None and self.runs(place.model):
                self.guarded(place.model, call)

        self._loop.call_later(seconds, due)

    def fire(self, name: str) -> None:
        """Raise an interrupt. Raises SimError."""
        if not self._interrupts.fire(name):
            raise SimError(f"no interrupt is called {name!r}; there are {', '.join(self._fabric.spec.interrupts)}")

    def transfer(self, name: str, address: int, length: int, done: Callable[[int, int], object]) -> Callable[[], None]:
        """Have a channel move memory, as its engine's registers say. Raises SimError, NodeError."""
        self.channels[name].begin(self._memory, address, length, done)
        return self.channels[name].cancel

    def main_memory(self, address: int, length: int) -> NDArray[np.uint8]:
        """Main memory as a master in the PL sees it."""
        return self._memory.view(address, length)


class _Place:
    """A model's surroundings."""

    def __init__(self, models: RunningModels) -> None:
        self._models = models
        self.model: Model | None = None

    def interrupt(self, name: str) -> None:
        self._models.fire(name)

    def memory(self, address: int, length: int) -> NDArray[np.uint8]:
        return self._models.main_memory(address, length)

    def send(self, stream: str, data: Any) -> bool:
        link = self._models.links.get(stream)
        if link is None:
            raise SimError(f"no stream is on channel {stream!r}; there are {', '.join(self._models.links)}")
        return link.offer(stream, np.ascontiguousarray(data).reshape(-1).view(np.uint8))

    def transfer(
        self, channel: str, address: int, length: int, done: Callable[[int, int], object]
    ) -> Callable[[], None]:
        def ended(moved: int, status: int) -> None:
            if self.model is not None:
                self._models.guarded(self.model, done, moved, status)

        return self._models.transfer(channel, address, length, ended)

    def after(self, seconds: float, call: Callable[[], object]) -> None:
        self._models.later(self, seconds, call)


def _arrays(fabric: Fabric, region: Region) -> Mapping[str, NDArray[Any]]:
    """The memories that a module in `region` sees by name: its own, and the static part's."""
    found: dict[str, NDArray[Any]] = {}
    for window in fabric.windows:
        for area in window.areas:
            if area.region is None or area.region is region:
                found[area.memory.name] = array(window, area)
    return found
