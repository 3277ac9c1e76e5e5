# SPDX-License-Identifier: Apache-2.0
"""The board library: parts, Vivado's board parts, pins by connector, pblocks that public designs have used, and the
interrupts of the PL that a stock image has given away.

One JSON file for each board in ``data/boards/``, each fact with its public source. A preset of the processing system
(DDR, MIO, reference clocks) comes from Vivado's board files, which `BoardDefinition.board_part` names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path

from cm.design.errors import BuildError
from cm.frozen import dataclass

FOLDER = Path(__file__).parent / "data" / "boards"
_SLICE = re.compile(r"(\w+)(?:\[(\d+)(?::(\d+))?\])?")


@dataclass(frozen=True, slots=True)
class Pin:
    """A package pin with its I/O standard; `name` as the build schema calls it."""

    name: str
    location: str
    iostandard: str


@dataclass(frozen=True, slots=True)
class BoardDefinition:
    """A board: `connectors` map a name to its pins, LSB first; `pblocks` a name to ranges."""

    name: str
    title: str
    part: str
    board_part: str
    connections: str  # from a SOM to its carrier: Vivado's property BOARD_CONNECTIONS
    clocks: Mapping[str, int]
    connectors: Mapping[str, tuple[Pin, ...]]
    pblocks: Mapping[str, tuple[str, ...]]
    taken_interrupts: tuple[int, ...]  # SPIs of the PL that a stock image's tree gives to another node
    sources: Mapping[str, str]

    def pins(self, text: str) -> tuple[Pin, ...]:
        """``pmoda``, ``pmoda[3]`` or ``pmoda[0:3]``; BuildError lists what there is."""
        found = _SLICE.fullmatch(text)
        pins = self.connectors.get(found[1]) if found else None
        if found is None or pins is None:
            known = ", ".join(f"{name}[0:{len(p) - 1}]" for name, p in self.connectors.items())
            raise BuildError(f"{self.title} has no pins {text!r}; there are {known}")
        first = int(found[2] or 0)
        last = int(found[3]) if found[3] else first if found[2] else len(pins) - 1
        if max(first, last) >= len(pins):
            raise BuildError(f"{found[1]} of {self.title} has {len(pins)} pins: {found[1]}[0:{len(pins) - 1}]")
        step = 1 if last >= first else -1
        return tuple(pins[index] for index in range(first, last + step, step))


@lru_cache(maxsize=1)
def boards() -> Mapping[str, BoardDefinition]:
    """All boards by name."""
    return {board.name: board for board in _read()}


def _read() -> Iterator[BoardDefinition]:
    for path in sorted(FOLDER.glob("*.json")):
        data = json.loads(path.read_text(encoding="utf-8"))
        connectors = {
            name: tuple(Pin(f"{name}[{i}]", pin, spec["iostandard"]) for i, pin in enumerate(spec["pins"]))
            for name, spec in data["connectors"].items()
        }
        yield BoardDefinition(
            name=data["name"],
            title=data["title"],
            part=data["part"],
            board_part=data["board_part"],
            connections=data.get("connections", ""),
            clocks=data["clocks"],
            connectors=connectors,
            pblocks={name: tuple(ranges) for name, ranges in data["pblocks"].items()},
            taken_interrupts=tuple(data.get("taken_interrupts", ())),
            sources=data["sources"],
        )
