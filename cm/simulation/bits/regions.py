# SPDX-License-Identifier: Apache-2.0
"""The logic in the regions of a simulated board, as the loaded bits configure it."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterable, Mapping
from pathlib import Path

from cm.design.generate.wrapper import black_box
from cm.design.hdl.model import PortDirection
from cm.design.openflow.layout import Layout, layouts
from cm.design.plan.system import System
from cm.errors import CmError
from cm.formats.bitstream import device_by_name
from cm.formats.bitstream.memory import FrameMemory
from cm.formats.xray import Database, Wires, decode
from cm.frozen import dataclass
from cm.simulation.bits.cells import Netlist
from cm.simulation.bits.extract import Boundary, extract
from cm.simulation.bits.verilog import Port, verilog
from cm.simulation.rtl.compile import Unit, Watched, compile_units
from cm.simulation.rtl.running_design import Library
from cm.simulation.rtl.tools import Tools
from cm.simulation.software.hardware.register_windows import Region

_log = logging.getLogger(__name__)
_NOTES = 3  # at most are reported one by one
_COLUMN = 7  # bits of a frame address below its column


class BitsError(CmError):
    """Frames cannot be simulated; the text says which configured feature is not understood."""

    code = "bits_error"


@dataclass(frozen=True, slots=True)
class Place:
    """A region on the device: its frames, its wires, and the module that stands for what is in it."""

    columns: frozenset[int]
    boundary: Boundary
    module: str
    ports: tuple[Port, ...]
    clock: str

    @classmethod
    def of(cls, layout: Layout) -> Place:
        """Raises BitsError for a region with several clocks: bits say which line a register uses, not which clock."""
        region = layout.region
        clocks = tuple(region.clocks)
        if len(clocks) != 1:
            raise BitsError(f"region {region.name} has {len(clocks)} clocks; only one can be run by its bits")
        inputs = {(at.tile.name, at.site_name, at.letter): at.bit.signal for at in layout.anchors if at.bit.into}
        outputs = {at.bit.signal: (at.tile.name, at.site_name, at.letter) for at in layout.anchors if not at.bit.into}
        ports = tuple(
            Port(port.name, port.width, port.direction is PortDirection.IN) for port in black_box(region).ports
        )
        return cls(layout.columns, Boundary(inputs, outputs), region.module, ports, clocks[0])


class LoadedBits:
    """The device's frames, and the compiled logic of each region that a bitstream has filled."""

    def __init__(
        self, database: Database, memory: FrameMemory, layouts: Mapping[str, Layout], tools: Tools, watched: Watched,
        folder: Path,
    ) -> None:  # fmt: skip
        """`folder` is for the Verilog that goes to the compiler."""
        self._database, self._wires, self._memory = database, Wires(database), memory
        self._places = {name: Place.of(layout) for name, layout in layouts.items()}
        self._tools, self._watched, self._folder = tools, watched, folder
        self._filled: set[str] = set()

    @classmethod
    def of(cls, system: System, tools: Tools, watched: Watched, folder: Path) -> LoadedBits:
        """Of a design, with no frames yet. BitstreamError, XrayError where its device is not known."""
        device = device_by_name(system.device)
        if device is None:
            raise BitsError(f"{system.device} is not a device that bitstreams are known of")
        database = Database.open(system.project.part)
        return cls(database, FrameMemory(device), layouts(system, database), tools, watched, folder)

    def take(self, stream: memoryview) -> None:
        """Take a bitstream that was loaded without an error: words in memory order."""
        written = {address >> _COLUMN for address in self._memory.load(bytes(stream))}
        self._filled |= {name for name, place in self._places.items() if not written.isdisjoint(place.columns)}

    def __call__(self, region: Region) -> Library | None:
        """The library of what is in a region; None while it is written, and before the first load."""
        if region.loading:
            self._filled.discard(region.name)
        if region.name not in self._filled:
            return None
        try:
            return Library(self.compiled(region.name))
        except CmError as error:
            _log.error("region %s: %s", region.name, error)
            return None

    def prepare(self, whole: Iterable[bytes], partial: Iterable[bytes]) -> None:
        """Take the static part; compile what partial bitstreams will leave in regions, so that loads take no time."""
        for stream in whole:
            self._memory.load(stream)
        before = dict(self._memory.frames)
        for stream in partial:
            written = {address >> _COLUMN for address in self._memory.load(stream)}
            for name, place in self._places.items():
                if not written.isdisjoint(place.columns):
                    self.compiled(name)
            self._memory.frames.clear()
            self._memory.frames.update(before)

    def netlist(self, name: str) -> Netlist:
        """What the frames configure in a region now."""
        features = decode(self._database, self._memory.frames).features
        return extract(self._database, self._wires, features, self._places[name].boundary)

    def compiled(self, name: str) -> Path:
        """The library of what the frames configure in a region now. Raises CmError if it cannot be made."""
        place, frames = self._places[name], self._memory.frames
        own = {address: frame for address, frame in frames.items() if frame and address >> _COLUMN in place.columns}
        key = hashlib.sha256(repr(sorted(own.items())).encode()).hexdigest()[:16]
        path = self._folder / f"{name}-{key}.v"
        if not path.exists():
            netlist = self.netlist(name)
            for note in netlist.notes[:_NOTES]:
                _log.warning("region %s: %s", name, note)
            if len(netlist.notes) > _NOTES:
                _log.warning("region %s: and %d more of the kind", name, len(netlist.notes) - _NOTES)
            clocks = dict.fromkeys(range(12), place.clock)
            path.write_text(verilog(netlist, place.module, place.ports, clocks), encoding="utf-8")
        (library,) = compile_units(self._tools, [Unit(f"the bits in {name}", place.module, (path,))], self._watched)
        return library
