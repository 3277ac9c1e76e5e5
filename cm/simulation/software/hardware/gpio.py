# SPDX-License-Identifier: Apache-2.0
"""GPIO chips of the processing system, and the regions that their lines isolate."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from cm.frozen import dataclass
from cm.schema.model import Decoupler, GpioLine
from cm.simulation.software.hardware.board_spec import BoardSpec

# As the kernel's driver gpio-zynq has them: label, and lines with those of EMIO at the end.
PROCESSOR: Mapping[str, tuple[str, int]] = MappingProxyType(
    {"7series": ("zynq_gpio", 118), "ultrascale+": ("zynqmp_gpio", 174)}
)
_NAME = re.compile(r"gpiochip\d+")
_FEWEST = 32  # lines of a chip that exists only because a schema names it


@dataclass(frozen=True, slots=True)
class Chip:
    """A GPIO chip; `name` is that of its node, `names` the places of lines that have one."""

    name: str
    label: str
    lines: int
    names: Mapping[str, int]


class Lines:
    """All chips of a board, and the values of their lines. Resets of the PL do not change them."""

    def __init__(self, spec: BoardSpec) -> None:
        decouplers = [region.decoupler for region in spec.regions.values() if region.decoupler]
        asked = [decoupler.gpio for decoupler in decouplers if decoupler.gpio]
        self.chips = tuple(_chips(spec.device.family.label, asked))
        self._by_any_name = {name: chip for chip in self.chips for name in (chip.label, chip.name)}
        self._high = {self._place(d.gpio) for d in decouplers if d.gpio and not d.active_high}  # regions are connected

    def value(self, chip: Chip, line: int) -> int:
        """0 or 1."""
        return int((chip.name, line) in self._high)

    def set(self, chip: Chip, line: int, value: int) -> None:
        """The processor drives it."""
        change = self._high.add if value else self._high.discard
        change((chip.name, line))

    def cuts(self, decoupler: Decoupler | None) -> bool:
        """Whether a region is isolated by its line."""
        if decoupler is None or decoupler.gpio is None:
            return False
        return (self._place(decoupler.gpio) in self._high) == decoupler.active_high

    def _place(self, line: GpioLine) -> tuple[str, int]:
        chip = self._by_any_name[line.chip]
        return chip.name, chip.names[line.line] if isinstance(line.line, str) else line.line


def _chips(family: str, asked: Sequence[GpioLine]) -> Iterable[Chip]:
    """The processing system's chip, which is the first, and others that schemas name."""

    def chip(name: str, label: str, lines: int) -> Chip:
        """Lines that are asked for by name are the last ones that nobody asks for by place."""
        wanted = [line.line for line in asked if line.chip in (name, label)]
        free = (place for place in reversed(range(lines)) if place not in wanted)
        names = dict.fromkeys(line for line in wanted if isinstance(line, str))
        return Chip(name, label, lines, {line: next(free) for line in names})

    label, lines = PROCESSOR[family]
    most: dict[str, int] = {label: lines, "gpiochip0": lines}
    for line in asked:
        most[line.chip] = max(most.get(line.chip, _FEWEST), line.line + 1 if isinstance(line.line, int) else 0)
    yield chip("gpiochip0", label, max(most.pop(label), most.pop("gpiochip0")))
    free = (name for number in range(1, 1000) if (name := f"gpiochip{number}") not in most)
    for name, count in most.items():
        yield chip(name, name, count) if _NAME.fullmatch(name) else chip(next(free), name, count)
