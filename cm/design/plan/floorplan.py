# SPDX-License-Identifier: Apache-2.0
"""Rectangles of sites on a device: what a region's pblock contains, and where two of them overlap."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from cm.design.project.model import Resources
from cm.frozen import dataclass

DEVICES = Path(__file__).parents[1] / "data" / "site_grids.json"
CLOCK_REGION = "CLOCKREGION"
_RANGE = re.compile(r"([A-Z0-9_]+)_X(\d+)Y(\d+)(?::\1_X(\d+)Y(\d+))?")
# sites that may be reconfigured, by family; all else belongs to the static part (UG909, "Reconfigurable Elements")
KINDS = {
    False: ("SLICE", "DSP48", "RAMB18", "RAMB36"),
    True: ("SLICE", "DSP48E2", "RAMB18", "RAMB36", "URAM288"),
}


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Sites of one kind, both corners included."""

    kind: str
    left: int
    bottom: int
    right: int
    top: int

    def meets(self, other: Rectangle) -> bool:
        """Whether two rectangles have sites in common; a RAMB36 is two RAMB18."""
        one, two = self.in_half(), other.in_half()
        if one.kind != two.kind:
            return False
        across = one.left <= two.right and two.left <= one.right
        return across and one.bottom <= two.top and two.bottom <= one.top

    def in_half(self) -> Rectangle:
        """Convert a rectangle of RAMB36 to RAMB18."""
        if self.kind != "RAMB36":
            return self
        return Rectangle("RAMB18", self.left, 2 * self.bottom, self.right, 2 * self.top + 1)

    @property
    def count(self) -> int:
        """Positions; a device may have no site at some of them."""
        return (self.right - self.left + 1) * (self.top - self.bottom + 1)

    def __str__(self) -> str:
        return f"{self.kind}_X{self.left}Y{self.bottom}:{self.kind}_X{self.right}Y{self.top}"


def rectangle(text: str) -> Rectangle | None:
    """Parse a range; None if it is not a rectangle of sites."""
    found = _RANGE.fullmatch(text)
    if found is None:
        return None
    left, bottom = int(found[2]), int(found[3])
    return Rectangle(found[1], left, bottom, int(found[4] or left), int(found[5] or bottom))


class Device:
    """The sites of a device, from public data."""

    def __init__(self, data: Mapping[str, Any]) -> None:
        self._sites: dict[str, list[Rectangle]] = {}
        for kind, runs in data["sites"].items():
            self._sites[kind] = [
                Rectangle(kind, left, run["rows"][0], right, run["rows"][1])
                for run in runs
                for left, right in run["columns"]
            ]
        self._regions: Mapping[str, Mapping[str, list[int]]] = data["clock_regions"]
        self._heights: Mapping[str, int] = data["rows"]

    def count(self, area: Rectangle) -> int:
        """Count the sites that really exist."""
        found = 0
        for run in self._sites.get(area.kind, ()):
            wide = min(area.right, run.right) - max(area.left, run.left) + 1
            high = min(area.top, run.top) - max(area.bottom, run.bottom) + 1
            found += max(0, wide) * max(0, high)
        return found

    def limits(self, kind: str) -> Rectangle | None:
        """The bounding rectangle of all sites of a kind."""
        runs = self._sites.get(kind)
        if not runs:
            return None
        return Rectangle(kind, min(r.left for r in runs), min(r.bottom for r in runs),
                         max(r.right for r in runs), max(r.top for r in runs))  # fmt: skip

    def unfold(self, area: Rectangle) -> Iterator[Rectangle]:
        """Yield clock regions as ranges of sites, and any other rectangle unchanged."""
        if area.kind != CLOCK_REGION:
            yield area
            return
        for x in range(area.left, area.right + 1):
            for y in range(area.bottom, area.top + 1):
                for kind, (left, right) in self._regions.get(f"X{x}Y{y}", {}).items():
                    height = self._heights[kind]
                    yield Rectangle(kind, left, y * height, right, (y + 1) * height - 1)


@lru_cache(maxsize=1)
def _devices() -> Mapping[str, Any]:
    devices: Mapping[str, Any] = json.loads(DEVICES.read_text(encoding="utf-8"))["devices"]
    return devices


def device_sites(name: str) -> Device | None:
    """The sites of a device; None if no public data exists."""
    data = _devices().get(name)
    return Device(data) if data is not None else None


def holds(areas: list[Rectangle], device: Device | None, ultrascale: bool) -> Resources:
    """The resources in a pblock of these rectangles; an upper bound for an unknown device."""
    count = dict.fromkeys(KINDS[ultrascale], 0)
    for area in areas:
        if area.kind in count:
            count[area.kind] += device.count(area) if device else area.count
    luts = count["SLICE"] * (8 if ultrascale else 4)
    bram = max(count["RAMB36"], count["RAMB18"] / 2)
    return Resources(luts, 2 * luts, bram, count["DSP48E2" if ultrascale else "DSP48"])
