# SPDX-License-Identifier: Apache-2.0
"""What a flipped bit changes about nextpnr's routed design, by what the bit means (UG474, UG953, its fasm.cc).

Each function returns None where what the bit means then is not written anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from design import Cell, Design, Pin

LETTERS = "ABCD"
_ASYNCHRONOUS = {"FDRE": "FDCE", "FDSE": "FDPE", "FDCE": "FDRE", "FDPE": "FDSE"}
_OTHER_VALUE = {"FDRE": "FDSE", "FDSE": "FDRE", "FDCE": "FDPE", "FDPE": "FDCE"}
_RESETS = {"FDRE": "R", "FDSE": "S", "FDCE": "CLR", "FDPE": "PRE", "LDCE": "CLR", "LDPE": "PRE"}
_LATCHES = {"FDRE": "LDCE", "FDCE": "LDCE", "FDSE": "LDPE", "FDPE": "LDPE"}
_MEMORIES = ("RAMD32", "SRL")


@dataclass(frozen=True)
class Change:
    """What is different about the design. `pins`: the nets that a pin of a cell reads now, 1 where all are 1."""

    cells: Mapping[str, Cell] = field(default_factory=dict)
    pins: Mapping[Pin, tuple[int, ...]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.cells or self.pins)


def table_bit(design: Design, tile: str, site: str, letter: str, bit: int) -> Change:
    """Bit `bit` of a look-up table's contents is the other one."""
    found = (design.at(tile, site, f"{letter}6LUT"), design.at(tile, site, f"{letter}5LUT"))
    changed = (_with_bit(design, cell, bit) for cell in found if cell is not None)
    return Change({cell.name: cell for cell in changed if cell is not None})


def _with_bit(design: Design, cell: Cell, bit: int) -> Cell | None:
    """The cell as a table of all pins of the slice, so that it sees what stands at those that it did not use.

    None where the bit is one that the cell never reads.
    """
    size = int(cell.element[1])
    if bit >> size:
        return None
    routed = {pin: design.routed(cell, pin) for pin in cell.nets if pin.startswith("A")}
    inputs = {pin: port for pin, port in cell.ports.items() if port.startswith("I")}
    contents = cell.init.rjust(1 << len(inputs), "0")
    table = []
    for address in range(1 << size):
        index = sum((address >> int(pin[1:]) - 1 & 1) << int(port[1:]) for pin, port in inputs.items())
        table.append(contents[-1 - index])
    table[bit] = "10"[int(table[bit])]
    nets = {**cell.nets, **{f"A{n}": routed.get(f"A{n}") or design.one for n in range(1, size + 1)}}
    ports = {f"A{n}": f"I{n - 1}" for n in range(1, size + 1)}
    ports |= {pin: port for pin, port in cell.ports.items() if pin.startswith("O")}
    return replace(cell, kind=f"LUT{size}", init="".join(reversed(table)), nets=nets, ports=ports)


def memory_bit(design: Design, tile: str, site: str, letter: str, bit: int) -> Change | None:
    """A bit of what a memory of two times 32 bits holds in the beginning: the upper half is the 6LUT's."""
    cell = design.at(tile, site, f"{letter}{'65'[bit < 32]}LUT")
    if cell is None or cell.kind != "RAMD32":
        return None
    lines = {int(pin[1:]) - 1: int(port[-1]) for pin, port in cell.ports.items() if port.startswith("RADR")}
    at = sum((bit >> line & 1) << port for line, port in lines.items())
    contents = list(cell.init.rjust(32, "0"))
    contents[-1 - at] = "10"[int(contents[-1 - at])]
    return Change({cell.name: replace(cell, init="".join(contents))})


def register(design: Design, tile: str, site: str, element: str, what: str) -> Change | None:
    """ZINI or ZRST of one register."""
    one = design.at(tile, site, element)
    if one is None:
        return None
    changed = replace(one, init=str(1 - int(one.init))) if what == "ZINI" else _of_kind(one, _OTHER_VALUE[one.kind])
    return Change({one.name: changed})


def control(design: Design, tile: str, site: str, what: str) -> Change | None:
    """FFSYNC, LATCH, CLKINV, CEUSEDMUX or SRUSEDMUX of a slice."""
    stores = design.of_slice(tile, site, ("FD",))
    resets = {cell.nets.get("SR") for cell in stores} - {None, design.zero}  # with 0, nextpnr takes the slice's own
    if what == "FFSYNC":
        return Change({c.name: _of_kind(c, _ASYNCHRONOUS[c.kind]) for c in stores})
    if what == "CLKINV":
        changed = [replace(cell, kind=f"{cell.kind}_1") for cell in stores]
        inverted = {"IS_CLK_INVERTED": "1'b1"}
        changed += [replace(cell, parameters=inverted) for cell in design.of_slice(tile, site, _MEMORIES)]
        return Change({cell.name: cell for cell in changed})
    if what == "LATCH":
        small = any(cell.element.endswith("5FF") for cell in stores)  # must be unused beside latches (UG474)
        clocked = resets and any(cell.kind in ("FDRE", "FDSE") for cell in stores)
        return None if small or clocked else Change({c.name: _latch(c) for c in stores})
    if what == "CEUSEDMUX":
        used = bool({cell.nets.get("CE") for cell in stores} - {None, design.one})
        enable = () if used else design.net_at(tile, f"{site}.CE")
        return Change(pins={(cell.name, "CE"): enable for cell in stores})
    reset = (design.zero,) if resets else design.net_at(tile, f"{site}.SR")
    return Change(pins={(cell.name, "SR"): reset for cell in stores})


def written(design: Design, tile: str, site: str, letter: str, what: str) -> Change | None:
    """Of a SLICEM: RAM or SRL (never written without), WEMUX.CE, DI1MUX."""
    own = [cell for cell in design.of_slice(tile, site, _MEMORIES) if letter in ("", cell.element[0])]
    if what in ("RAM", "SRL"):
        return Change(pins={(cell.name, "WE"): (design.zero,) for cell in own})
    if what == "WEMUX":
        by_enable = any(cell.kind.startswith("SRL") for cell in own)
        enable = design.net_at(tile, f"{site}.{'WE' if by_enable else 'CE'}")
        return Change(pins={(cell.name, "WE"): enable for cell in own})
    above = {"A": "BI", "B": "DI", "C": "DI"}[letter]  # what comes in place of the table's own pin
    if any(cell.kind.startswith("SRL") for cell in design.of_slice(tile, site, ("SRL",))):
        return None
    return Change(
        pins={(cell.name, "DI1"): design.net_at(tile, f"{site}.{above}") for cell in own if "DI1" in cell.nets}
    )


def carry(design: Design, tile: str, site: str, what: str) -> Change | None:
    """PRECYINIT off: 0 comes in; CY0 of a letter off: from the bypass pin, not from the table."""
    cell = design.at(tile, site, "CARRY4")
    if cell is None:
        return None
    if what.startswith("PRECYINIT"):
        pin = "CIN" if what.endswith("CIN") else "CYINIT"
        return Change(pins={(cell.name, pin): (design.zero,)})
    number = LETTERS.index(what[0])
    return Change(pins={(cell.name, f"DI{number}"): design.net_at(tile, f"{site}.{what[0]}X")})


def chosen(design: Design, tile: str, site: str, letter: str, mux: str, source: str) -> Change | None:
    """A register (FFMUX) or the output AMUX to DMUX (OUTMUX) has another source of the slice."""
    number = LETTERS.index(letter)
    places = {
        "O6": (f"{letter}6LUT", "O6"),
        "O5": (f"{letter}5LUT", "O5"),
        "XOR": ("CARRY4", f"O{number}"),
        "CY": ("CARRY4", f"CO{number}"),
        "F7": (f"F7{letter.replace('C', 'B')}MUX", "OUT"),
        "F8": ("F8MUX", "OUT"),
    }
    element, pin = places.get(source, ("", ""))
    cell = design.at(tile, site, element)
    if cell is None:
        return None
    net = cell.nets.get(pin)
    cells = {}
    if net is None:  # an output that nothing looked at
        net = design.spare
        cells[cell.name] = replace(cell, nets={**cell.nets, pin: net})
    wire = f"{tile}/{site}.{letter}{'FFMUX_OUT' if mux == 'FFMUX' else 'MUX'}"
    pins = dict.fromkeys(design.fed(wire), (net,))
    return Change(cells, pins) if pins else None


def cut(design: Design, pip: str) -> Change | None:
    """A pip is off: everything behind it reads 1. None where that is not all there is to it."""
    return _behind(design, pip, ()) if design.net_of(pip) is not None else None


def joined(design: Design, pip: str, other: str) -> Change | None:
    """A second pip drives the wire of one in use: 0 wins."""
    nets = design.net_of(pip), design.beside(pip).get(other)
    if None in nets or nets[0] == nets[1] or design.clock in nets or nets[0] in design.beyond:
        return None
    return _behind(design, pip, nets)


def _behind(design: Design, pip: str, nets: tuple[int, ...]) -> Change | None:
    pins = dict.fromkeys(design.behind(pip), nets)
    # nextpnr writes SRUSEDMUX only where the reset is not a constant 0: else the slice has its own 0
    pins = {(cell, pin): now for (cell, pin), now in pins.items() if pin != "SR" or _resets(design, cell)}
    pins = {(cell, pin): now for (cell, pin), now in pins.items() if pin != "CE" or _enables(design, cell)}
    return Change(pins=pins)


def _resets(design: Design, cell: str) -> bool:
    return design.cells[cell].nets.get("SR") != design.zero


def _enables(design: Design, cell: str) -> bool:
    return design.cells[cell].nets.get("CE") != design.one


def _of_kind(cell: Cell, kind: str) -> Cell:
    """Another register: its reset has another name."""
    return replace(cell, kind=kind, ports={**cell.ports, "SR": _RESETS[kind]})


def _latch(cell: Cell) -> Cell:
    ports = {**cell.ports, "CK": "G", "CE": "GE", "SR": _RESETS[_LATCHES[cell.kind]]}
    return replace(cell, kind=_LATCHES[cell.kind], ports=ports)
