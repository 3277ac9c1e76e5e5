# SPDX-License-Identifier: Apache-2.0
"""Rewrites distributed RAM in yosys' JSON into forms that nextpnr can pack.

nextpnr 0.11 fails an assertion on RAM64X1S. It looks for the contents of RAM32M and RAM64M under INITA, which
UNISIM calls INIT_A, so that they are initialised with zeros; given as INITA, those of a RAM32M fail an assertion.
Therefore RAM64X1S with the same address become a RAM64M, and a RAM32M with other contents than zeros two of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

_LETTERS = "ABCD"
Cell = dict[str, Any]


class _Bit(NamedTuple):
    """A memory column of one bit: read address, written bit, read bit, contents."""

    address: list[object]
    data: list[object]
    output: list[object] | None
    contents: str


def packable(netlist: dict[str, Any], top: str) -> None:
    """Change yosys' netlist in place."""
    cells: dict[str, Cell] = netlist["modules"][top]["cells"]
    groups: dict[tuple[object, ...], list[str]] = {}
    for name, cell in list(cells.items()):
        if cell["type"] == "RAM64X1S":
            groups.setdefault((*_address(cell), *_control(cell)), []).append(name)
        elif cell["type"] == "RAM32M" and any("1" in contents for contents in _contents(cell)):
            for half in range(2):
                cells[f"{name}_cm_half{half}"] = _cell(cell, list(_half(cell, half)))
            del cells[name]
    for names in groups.values():
        for at in range(0, len(names), len(_LETTERS)):
            few = names[at : at + len(_LETTERS)]
            bits = [_single(cells[name]) for name in few]
            # Padding goes first: the last port has the write address of all, so it must be one that is in use
            bits = [_Bit(bits[0].address, ["0"], None, "0" * 64)] * (len(_LETTERS) - len(bits)) + bits
            cells[f"{few[0]}_cm_joined"] = _cell(cells[few[0]], bits)
            for name in few:
                del cells[name]
    for cell in cells.values():
        if cell["type"] == "RAM64M":
            _name_contents(cell)


def _address(cell: Cell) -> tuple[object, ...]:
    return tuple(cell["connections"][f"A{bit}"][0] for bit in range(6))


def _control(cell: Cell) -> tuple[object, ...]:
    pins = cell["connections"]
    return pins["WE"][0], pins["WCLK"][0], cell["parameters"].get("IS_WCLK_INVERTED", "0")


def _contents(cell: Cell) -> list[str]:
    return [cell["parameters"].get(f"INIT_{letter}", "0" * 64) for letter in _LETTERS]


def _single(cell: Cell) -> _Bit:
    pins = cell["connections"]
    return _Bit(list(_address(cell)), pins["D"], pins["O"], cell["parameters"].get("INIT", "0" * 64))


def _half(cell: Cell, number: int) -> Iterator[_Bit]:
    """One of the two columns of each letter, as the lower half of a memory that is twice as deep."""
    pins = cell["connections"]
    for letter, contents in zip(_LETTERS, _contents(cell), strict=True):
        own = "0" * 32 + "".join(contents[-1 - 2 * word - number] for word in reversed(range(32)))
        output = pins.get(f"DO{letter}")
        data = pins.get(f"DI{letter}", ["0", "0"])  # none if nothing of the letter is read
        yield _Bit([*pins[f"ADDR{letter}"], "0"], [data[number]], output and [output[number]], own)


def _cell(like: Cell, bits: Sequence[_Bit]) -> Cell:
    connections = {name: like["connections"][name] for name in ("WE", "WCLK")}
    directions = dict.fromkeys(connections, "input")
    parameters = {"IS_WCLK_INVERTED": like["parameters"].get("IS_WCLK_INVERTED", "0")}
    for letter, bit in zip(_LETTERS, bits, strict=True):
        connections |= {f"ADDR{letter}": bit.address, f"DI{letter}": bit.data}
        directions |= {f"ADDR{letter}": "input", f"DI{letter}": "input"}
        parameters[f"INIT_{letter}"] = bit.contents
        if bit.output is not None:
            connections[f"DO{letter}"], directions[f"DO{letter}"] = bit.output, "output"
    return {
        "hide_name": 1,
        "type": "RAM64M",
        "parameters": parameters,
        "attributes": like["attributes"],
        "port_directions": directions,
        "connections": connections,
    }


def _name_contents(cell: Cell) -> None:
    for letter in _LETTERS:
        contents = cell["parameters"].get(f"INIT_{letter}")
        if contents is not None:
            cell["parameters"][f"INIT{letter}"] = contents
