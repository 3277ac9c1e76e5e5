# SPDX-License-Identifier: Apache-2.0
"""nextpnr's routed design: which cell stands where, and by which pips each net comes to which of its pins.

Nothing of `cm.simulation.bits` and nothing of the database: names are nextpnr's, of places too (``X87Y12``,
``SLICE_X0Y0``).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

_BEL = re.compile(r"(X\d+Y\d+)/(SLICE_X\dY0)\.(\w+)")
_SHIFTS = {
    "SRL16E": {f"A{bit + 2}": f"A{bit}" for bit in range(4)},
    "SRLC32E": {f"A{bit + 2}": f"A[{bit}]" for bit in range(5)},
}
Pin = tuple[str, str]  # name of a cell, pin


@dataclass(frozen=True)
class Cell:
    """A cell of the routed design; `ports`: its original ports by its pins, `nets`: the net at each pin."""

    name: str
    kind: str
    init: str
    tile: str
    site: str
    element: str  # A6LUT, B5FF
    nets: Mapping[str, int | None]
    ports: Mapping[str, str]
    parameters: Mapping[str, str] = field(default_factory=dict)

    @property
    def outside(self) -> bool:
        """Whether it stands for what is beyond the anchors."""
        return "begins" in self.name or "ends" in self.name


class Design:
    """A routed design. `routes` is what dump_routes.py writes."""

    def __init__(self, netlist: Mapping[str, Any], routes: Mapping[str, Any]) -> None:
        self._numbers = {name: net["bits"][0] for name, net in netlist["netnames"].items() if net["bits"]}
        self._ways = {self._numbers[name]: ways for name, ways in routes["ways"].items() if name in self._numbers}
        self._net_of = {pip: net for net, ways in self._ways.items() for _, _, pip in ways}
        self._before = {wire: before for ways in self._ways.values() for wire, before, _ in ways}
        self._users: dict[str, list[Pin]] = {}
        for users in routes["users"].values():
            for cell, pin, wire in users:
                self._users.setdefault(wire, []).append((cell, pin))
        self._beside, self._standing = routes["beside"], routes["standing"]
        self.cells = {cell.name: cell for cell in _cells(netlist["cells"])}
        kinds = {cell["type"]: cell["connections"] for cell in netlist["cells"].values()}
        self.one, self.zero = kinds["PSEUDO_VCC"]["Y"][0], kinds["PSEUDO_GND"]["Y"][0]
        self.clock = kinds["BUFGCTRL"]["O"][0]
        self.spare = 1 + max(self._numbers.values())  # the number of a net that there is not yet

    def at(self, tile: str, site: str, element: str) -> Cell | None:
        """The cell at a place."""
        return self._places.get((tile, site, element))

    def of_slice(self, tile: str, site: str, kinds: tuple[str, ...]) -> list[Cell]:
        """The cells of a slice whose kinds begin so."""
        here = (cell for cell in self.cells.values() if (cell.tile, cell.site) == (tile, site))
        return [cell for cell in here if cell.kind.startswith(kinds)]

    @cached_property
    def _places(self) -> Mapping[tuple[str, str, str], Cell]:
        return {(cell.tile, cell.site, cell.element): cell for cell in self.cells.values()}

    def net_at(self, tile: str, pin: str) -> tuple[int, ...]:
        """The net that stands at a pin of a slice (``SLICE_X0Y0.CE``), none where none does: then it reads 1.

        A net that was led somewhere else stands there too where its way has no switch between (UG474: bypass pins).
        """
        net = self._standing.get(f"{tile}/{pin}")
        return () if net is None else (self._numbers[net],)

    def net_of(self, pip: str) -> int | None:
        """The net that goes through a pip (``X87Y12/DESTINATION/SOURCE``)."""
        return self._net_of.get(pip)

    def beside(self, pip: str) -> Mapping[str, int]:
        """The pips into the same wire whose source carries a net of the module, and its number."""
        found = {other: self._numbers[net] for other, net in self._beside.get(pip, {}).items() if net in self._numbers}
        return {other: net for other, net in found.items() if net not in self.beyond}

    @cached_property
    def beyond(self) -> frozenset[int | None]:
        """The nets that come from beyond the anchors."""
        return frozenset(cell.nets.get("Q") for cell in self.cells.values() if cell.outside)

    def behind(self, pip: str) -> frozenset[Pin]:
        """The pins that a net comes to through a pip."""
        return self.fed(next(wire for wire, _, own in self._ways[self._net_of[pip]] if own == pip))

    def fed(self, wire: str) -> frozenset[Pin]:
        """The pins that a wire leads to."""
        net = next((net for net, ways in self._ways.items() if any(wire in way[:2] for way in ways)), None)
        ways: Sequence[tuple[str, str, str]] = self._ways.get(net or 0, ())
        found, grew = {wire}, True
        while grew:
            more = {wire for wire, before, _ in ways if before in found} - found
            found, grew = found | more, bool(more)
        return frozenset(pin for wire in found for pin in self._pins(wire, net))

    def _pins(self, wire: str, net: int | None) -> Iterator[Pin]:
        match = _BEL.fullmatch(wire)
        if match is None or not re.fullmatch(r"[A-D][1-6]", match[3]):
            yield from ((cell, pin) for cell, pin in self._users.get(wire, ()) if cell in self.cells)
            return
        # The router exchanges inputs of tables and renames the cell's afterwards: they are those of the slice.
        letter, number = match[3][0], self._before.get(wire, wire)[-1]
        ends = [(f"{letter}{size}LUT", f"A{number}") for size in "65"]
        if letter == "D":  # the address of all tables that are written
            ends += [(f"{other}{size}LUT", f"WA{number}") for other in "ABCD" for size in "65"]
        for element, pin in ends:
            cell = self.at(match[1], match[2], element)
            if cell is not None and cell.nets.get(pin) == net:
                yield cell.name, pin

    def routed(self, cell: Cell, pin: str) -> int | None:
        """The net at an input of a table, where it is routed to it: what nothing is routed to reads 1."""
        net = cell.nets.get(pin)
        before = (before for wire, before, _ in self._ways.get(net or 0, ()) if wire.startswith(f"{cell.tile}/"))
        return net if any(one.endswith(f"_{cell.element[0]}{pin[1:]}") for one in before) else None


def _cells(cells: Mapping[str, Any]) -> Iterator[Cell]:
    for name, cell in cells.items():
        attributes = cell["attributes"]
        match = _BEL.fullmatch(attributes.get("NEXTPNR_BEL", ""))
        if match is None or "X_ORIG_TYPE" not in attributes:
            continue
        ports = {
            key.removeprefix("X_ORIG_PORT_"): value.strip()
            for key, value in attributes.items()
            if key.startswith("X_ORIG_PORT_")
        }
        nets = {pin: (bits[0] if bits else None) for pin, bits in cell["connections"].items()}
        kind = attributes["X_ORIG_TYPE"]
        if kind in _SHIFTS:  # their attributes have the pins of before the packing
            ports = {pin: port for pin, port in ports.items() if not re.fullmatch(r"A\d", pin)} | _SHIFTS[kind]
        yield Cell(name, kind, cell["parameters"].get("INIT", "0"), *match.groups(), nets, ports)
