# SPDX-License-Identifier: Apache-2.0
"""The models of a static part's blocks: made when its image was loaded, ended by the next one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

from cm.frozen import dataclass
from cm.schema.model import Access, Block, Config, ConfigType
from cm.simulation.software.hardware.block_models import STANDARD, HlsKernel, Passes, expected
from cm.simulation.software.hardware.board_spec import chain
from cm.simulation.software.hardware.dma import Bytes
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.models import Model, Models, Registers, Surroundings
from cm.simulation.software.hardware.register_windows import Area, Cell, Window
from cm.wire.lazy_numpy import NDArray, np

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Running:
    """A model with what the bus needs of it; `window` None: streams alone pass through it."""

    block: Block
    model: Model
    window: Window | None
    start: int = 0  # of the block in its window
    end: int = 0


class Place(Surroundings, Protocol):
    """A model's surroundings; the calls that it asked for are made as long as `model` runs."""

    model: Model | None


class RunningBlocks:
    """The blocks of the configuration whose static part is loaded; of partial configurations it always is."""

    def __init__(
        self,
        fabric: Fabric,
        models: Models,
        place: Callable[[], Place],
        guarded: Callable[..., Any],
    ) -> None:
        """`place` makes a model's surroundings, `guarded` calls a model whose defect must not end the board."""
        self._fabric, self._models, self._place, self._guarded = fabric, models, place, guarded
        self._running: dict[str, _Running] = {}
        self._config: Config | None = None
        self._images: Mapping[str, Config] = {}
        self.digest: Callable[[memoryview], str] = lambda _: ""
        given = [config for config in fabric.spec.configs if config.blocks]
        if given:
            fabric.resetting = self._stop
            for config in given:
                self._say(config)
        self._resident = next((config for config in given if config.type is ConfigType.PARTIAL), None)
        if self._resident is not None:
            self._start(self._resident)

    def know(self, images: Mapping[str, Config], digest: Callable[[memoryview], str]) -> None:
        """The static parts by what `digest` makes of an image that was loaded."""
        self._images, self.digest = images, digest
        if images:
            self._fabric.configured = self._configured

    def has(self, model: Model) -> bool:
        """Whether it runs."""
        return any(one.model is model for one in self._running.values())

    def forget(self, model: Model) -> None:
        """It failed."""
        self._running = {name: one for name, one in self._running.items() if one.model is not model}

    def path(self, stream: str) -> list[_Running | None] | None:
        """What a stream to the PL passes through up to one from it, None where nothing models a block.

        None instead of a list: the loaded design says nothing of streams.
        """
        config = self._config
        if config is None or not any(block.peers for block in config.blocks.values()):
            return None
        names = chain(config, stream)
        return [self._running.get(name) for name in names[:-1]] if names else [None]

    def through(self, stream: str, frame: Bytes) -> tuple[bool, Bytes | None]:
        """Whether the design says where a stream leads, and what comes of a frame on its way there."""
        path = self.path(stream)
        if path is None:
            return False, None
        data: Any = frame
        for one in path:
            data = None if one is None else self._guarded(one.model, one.model.frame, stream, data)
            if data is None:
                return True, None
        return True, np.ascontiguousarray(data).reshape(-1).view(np.uint8)

    def plain(self, stream: str) -> bool:
        """Whether data of a stream leaves as it comes."""
        return all(one is not None and isinstance(one.model, Passes) for one in self.path(stream) or ())

    def at(self, window: Window, offset: int) -> _Running | None:
        """The block whose model sees a byte of a window."""
        if not self._running:
            return None
        here = (one for one in self._running.values() if one.window is window and one.start <= offset < one.end)
        return next(here, None)

    def read(self, window: Window, offset: int) -> int | None:
        """What a model answers at a word that it answers for itself; else None."""
        one = self.at(window, offset)
        if one is None or offset - one.start not in one.model.reads:
            return None
        value: int | None = self._guarded(one.model, one.model.read, offset - one.start)
        return value

    def written(self, window: Window, offset: int, before: int) -> None:
        """The bus wrote a word."""
        one = self.at(window, offset)
        if one is None:
            return
        value = int.from_bytes(window.memory[offset : offset + 4], "little")
        self._guarded(one.model, one.model.wrote, offset - one.start, value, before)
        cell = window.cell_at(offset)
        if cell is not None:
            self._guarded(one.model, one.model.written, cell.register.name.removeprefix(one.block.prefix), value)

    def _configured(self, words: memoryview) -> None:
        config = self._images.get(self.digest(words))
        if config is not None:
            self._stop()
            self._start(config)

    def _stop(self) -> None:
        running, self._running, self._config = self._running, {}, None
        for one in running.values():
            self._guarded(one.model, one.model.stop)
            self._ask(one, False)

    def _start(self, config: Config) -> None:
        self._config = config
        for block in config.blocks.values():
            kind = self._kind(config, block)
            if kind is not None:
                streams = [config.streams[name] for name in block.streams if name in config.streams]
                self._make(block, kind, {one.direction.value: one.channel for one in streams})

    def _make(self, block: Block, kind: type[Model], channels: Mapping[str, str]) -> None:
        window = self._fabric.window_at(block.base_address) if block.size else None
        start = block.base_address - window.spec.address if window else 0
        end = min(start + block.size, window.spec.size) & ~3 if window else 0
        words = np.frombuffer(window.memory, "<u4", (end - start) // 4, start) if window else np.zeros(0, "<u4")
        place = self._place()
        parts = (_registers(block, window, start, end), _arrays(window, start, end), place)
        try:
            model = kind.of_block(block, words, channels, *parts)
        except Exception:  # noqa: BLE001 - a user's model must not end the board
            _log.exception("the model %s of %s could not be started", kind.__name__, block.name)
            return
        place.model = model
        self._running[block.name] = made = _Running(block, model, window, start, end)
        self._ask(made, True)

    def _ask(self, one: _Running, ask: bool) -> None:
        """Whether the bus has to be asked for what the model answers for itself."""
        for offset in one.model.reads:
            if one.window is not None and one.start + offset < one.end:
                cell = one.window.cell_at(one.start + offset)
                always = cell is not None and cell.access is Access.WO
                one.window.mirror.ask(one.start + offset, 4, ask or always)

    def _kind(self, config: Config, block: Block) -> type[Model] | None:
        kind = self._models.of_vlnv(block.vlnv) or STANDARD.get(block.vlnv.rpartition(":")[0])
        kernel = any(
            {"ap_start", "ap_done", "ap_idle"} <= register.fields.keys() and register.address == block.base_address
            for register in config.registers.values()
        )
        return kind or (HlsKernel if kernel and block.size else None)

    def _say(self, config: Config) -> None:
        """What nothing models, once."""
        for block in config.blocks.values():
            streams = block.peers or any(block.name in other.peers for other in config.blocks.values())
            kind = self._kind(config, block)
            if (kind is None and expected(block)) or (kind is HlsKernel and streams):
                keeps = ["registers keep what is written"] if block.size else []
                passed = "streams give nothing" if kind is None else "streams pass unchanged"
                told = ", ".join([*keeps, *([passed] if streams else [])])
                _log.warning("%s (%s) of %s has no model: %s", block.name, block.vlnv, config.name, told)


def _registers(block: Block, window: Window | None, start: int, end: int) -> Registers:
    """The registers in a block, by their names in it."""
    found: dict[str, Cell] = {}
    for offset, cells in window.cells.items() if window else ():
        if start <= offset < end and cells[0].region is None:
            found[cells[0].register.name.removeprefix(block.prefix)] = cells[0]
    return Registers(found)


def _arrays(window: Window | None, start: int, end: int) -> Mapping[str, NDArray[Any]]:
    return {area.memory.name: array(window, area) for area in _areas(window, start, end)} if window else {}


def _areas(window: Window, start: int, end: int) -> Iterator[Area]:
    return (area for area in window.areas if area.region is None and start <= area.offset < end)


def array(window: Window, area: Area) -> NDArray[Any]:
    """A memory as an array of the shape that the schema gives, over the bytes that the bus sees."""
    raw = np.frombuffer(window.memory, np.uint8, area.end - area.offset, area.offset)
    typed = raw.view(np.dtype(area.memory.dtype).newbyteorder("<"))
    shaped: NDArray[Any] = typed.reshape(area.memory.shape) if area.memory.shape else typed
    return shaped
