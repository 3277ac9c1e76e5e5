# SPDX-License-Identifier: Apache-2.0
"""The programmable logic: regions, what is loaded in them, and the registers they answer with."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property

from cm.schema.model import Access, Memory, Register
from cm.simulation.software.hardware.board_spec import BoardSpec, ModuleSpec, RegionSpec
from cm.simulation.software.hardware.gpio import Chip, Lines
from cm.simulation.software.hardware.models import Registers
from cm.simulation.software.hardware.register_windows import Area, Cell, Region, Window, same_place
from cm.wire.lazy_numpy import NDArray, np

FUNCTIONAL_RESETS: Mapping[str, int] = {"focus": 1, "zoom": 1}
_GARBAGE = 1 << 22


class Fabric:
    """Regions and windows of a board, and the rules by which they change."""

    def __init__(self, spec: BoardSpec, seed: int = 1) -> None:
        self.spec = spec
        self.regions = {name: Region(region) for name, region in spec.regions.items()}
        self.windows = [Window(window) for window in spec.windows]
        self.lines = Lines(spec)
        self.changed: Callable[[], None] = lambda: None  # called when data may flow that could not before
        self.answering: Callable[[Region], None] = lambda _: None  # called when a region begins or ceases to answer
        self.loaded: Callable[[Region], None] = lambda _: None  # called when another module runs, or none
        self.altered: Callable[[Region], None] = lambda _: None  # called when bits have changed under what runs
        self.configured: Callable[[memoryview], None] = lambda _: None  # called with each bitstream that loaded well
        self.resetting: Callable[[], None] = lambda: None  # called before everything is reset as after power-up
        self._by_name: dict[str, list[Cell]] = {}
        self._seed = seed
        self._noise_at = 0
        self._views: dict[str | None, Mapping[str, Cell]] = {}
        for register in (*spec.registers, *_identities(spec.regions.values())):
            self._add(register)
        for memory in spec.memories:
            self._add_memory(memory)
        self.reset()

    def window_at(self, address: int) -> Window | None:
        """The window that holds a physical address."""
        for window in self.windows:
            if window.spec.address <= address < window.spec.end:
                return window
        return None

    def cell(self, name: str, region: str | None) -> Cell | None:
        """The register of that name as `region` sees it: its module's, its own, or the static part's."""
        found = self._views.get(region, {}).get(name)
        if found is not None:
            return found
        cells = self._by_name.get(name, [])
        for cell in cells:
            if cell.region is None or cell.region.name == region:
                return cell
        return None

    def registers(self, region: str | None) -> Registers:
        """The registers as a model in `region` sees them."""
        if region not in self._views:
            self._views[region] = self._view(region)
        return Registers(self._views[region])

    def start_load(self, region: Region) -> None:
        """The first frame of a bitstream reaches the region: what ran there is gone."""
        region.loading = True
        region.module = None
        self.loaded(region)
        self.answering(region)
        self.changed()

    def end_load(self, region: Region, module: ModuleSpec | None) -> None:
        """The load is over; `module` runs with fresh registers, or nothing does."""
        region.loading = False
        region.module = module
        self._views.clear()
        if module is not None:
            self._reset_areas(region)
        self._reset_cells(region)
        self.loaded(region)
        self.answering(region)
        self.changed()

    def reset(self) -> None:
        """Reset as after power-up or a full image: no modules, decoupled only by GPIO lines, registers at reset."""
        self.resetting()
        self._views.clear()
        for region in self.regions.values():
            region.module, region.loading = None, False
            region.decoupled = self.lines.cuts(region.spec.decoupler)
            self.loaded(region)
            self.answering(region)
        for window in self.windows:
            window.mirror.clear()
        for region in self.regions.values():
            self._reset_cells(region)
            self._set_decoupler_bit(region)
        self._reset_cells(None)
        self.changed()

    @cached_property
    def _noise(self) -> NDArray[np.uint8]:
        return np.random.default_rng(self._seed).integers(0, 256, _GARBAGE, np.uint8)

    def noise(self, length: int) -> NDArray[np.uint8]:
        """Garbage, different each time but the same in every run with the same seed."""
        if length > len(self._noise) // 2:
            return np.resize(self._noise, length)
        start = self._noise_at
        self._noise_at = (start + 4099) % (len(self._noise) // 2)
        return self._noise[start : start + length]

    def set_decoupled(self, region: Region, decoupled: bool) -> None:
        """Isolate the region, or connect it again."""
        if region.decoupled != decoupled:
            region.decoupled = decoupled
            self.answering(region)
            self.changed()

    def drive_line(self, chip: Chip, line: int, value: int) -> None:
        """The processor drives a line of a GPIO chip; regions may be decoupled by it."""
        self.lines.set(chip, line, value)
        for region in self.regions.values():
            if region.spec.decoupler is not None and region.spec.decoupler.gpio is not None:
                self.set_decoupled(region, self.lines.cuts(region.spec.decoupler))

    def _add(self, register: Register) -> None:
        window = self.window_at(register.address)
        if window is None:
            return
        region = self.regions.get(register.region) if register.region else None
        if any(
            same_place(known.register, register) and known.region is region
            for known in self._by_name.get(register.name, ())
        ):
            return
        cell = Cell(window.memory, register.address - window.spec.address, register, region)
        window.add(cell)
        self._by_name.setdefault(register.name, []).append(cell)

    def _add_memory(self, memory: Memory) -> None:
        window = self.window_at(memory.address)
        if window is not None:
            region = self.regions.get(memory.region) if memory.region else None
            window.areas.append(Area(memory.address - window.spec.address, memory, region))

    def _reset_areas(self, region: Region) -> None:
        """The block RAM of a circuit that was just loaded: zero."""
        for window in self.windows:
            for area in window.areas:
                if area.region is region:
                    window.memory[area.offset : area.end] = bytes(area.end - area.offset)

    def _view(self, region: str | None) -> Mapping[str, Cell]:
        module = self.regions[region].module if region in self.regions else None
        cells = {}
        for name, found in self._by_name.items():
            for cell in found:
                mine = cell.region is None or cell.region.name == region
                if mine and (module is None or same_place(module.registers.get(name), cell.register)):
                    cells[name] = cell
        return cells

    def _reset_cells(self, region: Region | None) -> None:
        module = region.module if region else None
        for name, cells in self._by_name.items():
            for cell in cells:
                if cell.region is not region:
                    continue
                if module is None or same_place(module.registers.get(name), cell.register):
                    cell.value = _reset_value(cell.register)
        identity = self._by_name.get(_identity_name(region.name)) if region else None
        if identity and module is not None:
            identity[0].value = module.identity

    def _set_decoupler_bit(self, region: Region) -> None:
        """After a reset regions are connected: the registers of their decouplers say so."""
        decoupler = region.spec.decoupler
        window = self.window_at(decoupler.base_address + decoupler.offset) if decoupler and decoupler.size else None
        if decoupler is None or window is None:
            return
        at, length = decoupler.base_address + decoupler.offset - window.spec.address, decoupler.width // 8
        for step in decoupler.sequence:
            window.memory[at + step.offset : at + step.offset + length] = step.couple.to_bytes(length, "little")
        if not (decoupler.sequence or decoupler.active_high):
            window.memory[at + decoupler.bit // 8] |= 1 << decoupler.bit % 8


def _identity_name(region: str) -> str:
    return f"{region}:identity"  # no schema can use the colon


def _identities(regions: Iterable[RegionSpec]) -> Iterator[Register]:
    for region in regions:
        if region.identity is not None:
            at = region.identity
            name = _identity_name(region.name)
            yield Register(name, at.base_address, at.offset, at.width, Access.RO, region=region.name)


def _reset_value(register: Register) -> int:
    if register.reset is not None:
        return register.reset
    return FUNCTIONAL_RESETS.get(register.name, 0)
