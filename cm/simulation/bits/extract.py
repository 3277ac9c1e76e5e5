# SPDX-License-Identifier: Apache-2.0
"""Features → netlist: from the outputs of a region back to its inputs, through whatever is configured on the way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from cm.formats.xray import Database, Feature, Wires
from cm.frozen import dataclass, field
from cm.simulation.bits.blocks import HALVES, Half
from cm.simulation.bits.cells import (
    ONE,
    ZERO,
    BlockMemory,
    Carry,
    Cell,
    Dsp,
    FlipFlop,
    Lut,
    LutMemory,
    Mux,
    Net,
    Netlist,
)
from cm.simulation.bits.dsp import Slice48
from cm.simulation.bits.routing import ClockLine, Constant, Routing, SitePin, Source
from cm.simulation.bits.slices import Slice

Place = tuple[str, str, str]  # tile, site as features name it (SLICEL_X0), letter of a look-up table


@dataclass(frozen=True, slots=True)
class Boundary:
    """Where signals enter and leave: look-up tables at known places.

    The value of an input stands at every pin of its table that something is routed to; that of an output is its
    table's O6. Both are called ``NAME[BIT]``.
    """

    inputs: Mapping[Place, str] = field(default_factory=dict)
    outputs: Mapping[str, Place] = field(default_factory=dict)


def extract(database: Database, wires: Wires, features: Iterable[Feature], boundary: Boundary) -> Netlist:
    """Return what the outputs depend on. Clocks are nets ``clock:N``, by the number of the line in their row."""
    return _Extraction(database, wires, Routing(database, wires, features), boundary).run()


class _Extraction:
    def __init__(self, database: Database, wires: Wires, routing: Routing, boundary: Boundary) -> None:
        self._database, self._wires, self._routing, self._boundary = database, wires, routing, boundary
        self._slices: dict[str, Slice] = {}
        self._cells: dict[Net, Cell] = {}
        self._pins: dict[tuple[str, str, str], Net] = {}
        self._notes: dict[str, None] = {}
        self._meetings = 0

    def run(self) -> Netlist:
        outputs = {name: f"{tile}.{site}.{letter}O6" for name, (tile, site, letter) in self._boundary.outputs.items()}
        todo = list(outputs.values())
        made: dict[Net, Cell] = {}
        while todo:
            net = todo.pop()
            if net in made or net in (ZERO, ONE) or ":" in net:
                continue
            cell = self._cells.get(net) or self._making(net)
            made.update(dict.fromkeys(nets_of(cell), cell))
            todo += needs(cell)
        return Netlist(tuple(dict.fromkeys(made.values())), outputs, tuple(self._notes))

    def _making(self, net: Net) -> Cell:
        name, _, inner = net.rpartition(".")
        tile, _, site = name.partition(".")
        if site.startswith("RAMB18_"):
            return self._half(tile, int(site[-1])).memory()
        return self._dsp(tile, site, net) if site.startswith("DSP_") else self._slice(name).making(inner)

    def _dsp(self, tile: str, name: str, net: Net) -> Cell:
        own = Slice48(f"{tile}.{name}", self._own(tile, f"DSP48.{name}"), lambda pin: self._wire(tile, f"{name}_{pin}"))
        why = own.why_not(net.rpartition(".")[2])
        if why:
            self._note(f"{own.name} {why}, and is not simulated: it reads as 0")
            return Lut(0, (), net)
        return own.cell()

    def _slice(self, name: str) -> Slice:
        if name not in self._slices:
            tile, _, site = name.partition(".")
            self._slices[name] = Slice(name, self._own(tile, site), lambda pin: self._pin(tile, site, pin))
        return self._slices[name]

    def _own(self, tile: str, site: str) -> frozenset[str]:
        """A site's features, without its name."""
        start = f"{site}."
        return frozenset(one.removeprefix(start) for one in self._routing.features(tile) if one.startswith(start))

    def _pin(self, tile: str, site: str, pin: str) -> Net:
        key = (tile, site, pin)
        if key not in self._pins:
            self._pins[key] = self._find(tile, site, pin)
        return self._pins[key]

    def _find(self, tile: str, site: str, pin: str) -> Net:
        kind, _, column = site.rpartition("_X")
        pins = next(
            one.pins
            for one in self._wires.kind(self._database.tiles[tile].kind).sites
            if one.type == kind and str(one.x) == column
        )
        if pin not in pins:
            return ONE
        found = self._routing.sources(tile, pins[pin])
        port = self._boundary.inputs.get((tile, site, pin[0])) if pin[1:].isdigit() else None
        if port is not None and any(not isinstance(source, Constant) for source in found):
            return f"port:{port}"
        return self._joined(found, f"{tile}.{site}.{pin}")

    def _joined(self, sources: tuple[Source, ...], where: str) -> Net:
        """What drives a wire, together."""
        nets = list(dict.fromkeys(map(self._net, sources)))
        if not nets:
            return ONE  # a wire that nothing drives is pulled up
        return nets[0] if len(nets) == 1 else self._meet(nets, where)

    def _net(self, source: Source) -> Net:
        if isinstance(source, Constant):
            return ONE if source.value else ZERO
        if isinstance(source, ClockLine):
            return f"clock:{source.number}"
        if source.site.startswith("SLICE"):
            return self._slice(f"{source.tile}.{source.site}").output(source.pin)
        if source.site.startswith("RAMB18_"):
            return self._block_output(source)
        if source.site.startswith("DSP_"):
            return f"{source.tile}.{source.site}.{source.pin}"
        kind = source.site.rpartition("_X")[0]
        self._note(f"{source.tile}: {kind}.{source.pin} drives logic and is not simulated: it reads as 0")
        return ZERO

    def _block_output(self, source: SitePin) -> Net:
        half = self._half(source.tile, int(source.site[-1]))
        why = half.why_not()
        if why:
            self._note(f"{half.name} {why}, and is not simulated: it reads as 0")
            return ZERO
        return half.output(source.pin)

    def _half(self, tile: str, number: int) -> Half:
        name = f"RAMB18_Y{number}"
        prefix = next(prefix for prefix, half in HALVES.items() if half == number)
        return Half(f"{tile}.{name}", self._own(tile, name), lambda pin: self._wire(tile, prefix + pin))

    def _wire(self, tile: str, wire: str) -> Net:
        key = (tile, "", wire)
        if key not in self._pins:
            self._pins[key] = self._joined(self._routing.sources(tile, wire), f"{tile}.{wire}")
        return self._pins[key]

    def _meet(self, nets: list[Net], where: str) -> Net:
        """The result of several drivers: one that pulls down wins."""
        self._note(f"{where} has {len(nets)} drivers")
        self._meetings += 1
        output = f"meeting.{self._meetings}.O6"
        self._cells[output] = Lut(1 << (1 << len(nets)) - 1, tuple(nets), output)
        return output

    def _note(self, text: str) -> None:
        self._notes[text] = None


def nets_of(cell: Cell) -> tuple[Net, ...]:
    """The nets that a cell makes."""
    if isinstance(cell, LutMemory):
        return (cell.o6, cell.o5, cell.last)
    if isinstance(cell, BlockMemory):
        return tuple(net for port in cell.ports for net in port.outputs)
    if isinstance(cell, Dsp):
        return cell.outputs
    if isinstance(cell, Carry):
        return (*cell.sums, *cell.carries)
    return (cell.output,)


def needs(cell: Cell) -> Iterator[Net]:
    """The nets that a cell reads."""
    if isinstance(cell, Lut):
        yield from cell.inputs
    elif isinstance(cell, Mux):
        yield from (cell.zero, cell.one, cell.select)
    elif isinstance(cell, Carry):
        yield from (cell.begin, *cell.select, *cell.data)
    elif isinstance(cell, BlockMemory):
        for port in cell.ports:
            yield from (port.clock[0], port.enable[0], port.reset[0], *port.address, *port.data, *port.lanes)
    elif isinstance(cell, Dsp):
        yield from (net for _, port in cell.pins for net, _ in port)
    elif isinstance(cell, FlipFlop):
        yield from (cell.clock, cell.data, cell.enable, cell.reset)
    else:
        yield from (*cell.inputs, *cell.write, *(net for net, _ in cell.enables), cell.data, cell.high_data, cell.clock)
