# SPDX-License-Identifier: Apache-2.0
"""Project X-Ray's database of one part, read file by file as it is asked."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from cm.formats.xray.features import DatabaseMissing, Feature, XrayError, read_features
from cm.formats.xray.tiles import BLOCKS, Segbits, Tile, read_ppips, read_segbits, read_tiles
from cm.home import cache_home

VARIABLE = "CM_XRAY_DATABASE"
_INSTALLED = Path("/usr/share/prjxray/database")  # where Debian's prjxray-database has it


def find_database(setting: Path | None = None) -> Path:
    """Return the folder with ``zynq7/``, ``artix7/``, …: `setting`, CM_XRAY_DATABASE, Debian's, else a fetched one.

    Raises DatabaseMissing, which names the places that were searched.
    """
    named = setting or (Path(os.environ[VARIABLE]) if os.environ.get(VARIABLE) else None)
    cache = cache_home() / "fpga-cm" / "packages"
    fetched = sorted(cache.glob("*/usr/share/prjxray/database"), key=lambda path: path.stat().st_mtime, reverse=True)
    places = [named] if named else [_INSTALLED, *fetched]
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        looked = ", ".join(map(str, [named] if named else [_INSTALLED, cache]))
        raise DatabaseMissing(
            f"no database of Project X-Ray in {looked}: cm build tools --fetch brings it, {VARIABLE} names another"
        )
    return found


class Database:
    """What the database says about one part, such as ``xc7z010clg400-1``. Files are read when they are first needed."""

    def __init__(self, family: Path, part: str, fabric: str) -> None:
        self.family = family
        self.part = part
        self.fabric = fabric
        self._segbits: dict[tuple[str, str], Segbits] = {}
        self._ppips: dict[str, Mapping[str, str]] = {}

    @classmethod
    def open(cls, part: str, folder: Path | None = None) -> Database:
        """Open the database of a part, or of a device's first part (``xc7z010``).

        `folder` is what `find_database` returns, by default. Raises DatabaseMissing with the parts there are.
        """
        root = folder or find_database()
        there = {path.parent.name: path.parent.parent for path in sorted(root.glob("*/*/part.json"))}
        chosen = part if part in there else next((name for name in there if name.startswith(part)), None)
        if chosen is None:
            known = ", ".join(there) or "none at all"
            raise DatabaseMissing(f"the database in {root} has no part {part!r}; it has {known}")
        family = there[chosen]
        fabrics = [path.parent.name for path in family.glob("*/tilegrid.json") if chosen.startswith(path.parent.name)]
        if not fabrics:
            fabrics = _shared_fabric(family, chosen)
        return cls(family, chosen, fabrics[0])

    @cached_property
    def tiles(self) -> Mapping[str, Tile]:
        """All tiles by name."""
        return read_tiles(self.family / self.fabric / "tilegrid.json")

    @cached_property
    def tile_at(self) -> Mapping[tuple[int, int], Tile]:
        """All tiles by their place in the grid."""
        return {(tile.x, tile.y): tile for tile in self.tiles.values()}

    @cached_property
    def idcode(self) -> int:
        """The IDCODE of the part, silicon revision included."""
        return int(self.json(f"{self.part}/part.json")["idcode"])

    @cached_property
    def required(self) -> frozenset[Feature]:
        """Features that every full bitstream of the part has."""
        path = self.family / self.part / "required_features.fasm"
        return read_features(path.read_text("utf-8").splitlines(), str(path)) if path.is_file() else frozenset()

    def segbits(self, kind: str, block: str = "CLB_IO_CLK") -> Segbits:
        """The features of a kind of tile with bits in a block (`BLOCK_RAM` holds the contents of memories)."""
        key = kind, block
        if key not in self._segbits:
            self._segbits[key] = read_segbits(self.family / f"segbits_{kind.lower()}{BLOCKS[block]}.db")
        return self._segbits[key]

    def ppips(self, kind: str) -> Mapping[str, str]:
        """The pips of a kind of tile that have no bits: ``DESTINATION.SOURCE`` → always, default, hint."""
        if kind not in self._ppips:
            self._ppips[kind] = read_ppips(self.family / f"ppips_{kind.lower()}.db")
        return self._ppips[kind]

    def json(self, inside: str) -> Any:
        """A JSON file of the family's folder. Raises XrayError."""
        path = self.family / inside
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise XrayError(f"{path}: {error}") from error


def _shared_fabric(family: Path, part: str) -> list[str]:
    """The die that a device shares with a larger one, by ``mapping/``: lines of ``"xc7a35t":`` and ``fabric: …``."""
    device = ""
    for line in (family / "mapping" / "devices.yaml").read_text("utf-8").splitlines():
        words = line.replace('"', "").replace("'", "").split()
        if len(words) == 1 and words[0].endswith(":"):
            device = words[0][:-1]
        elif words[:1] == ["fabric:"] and device and part.startswith(device):
            return [words[1]]
    raise DatabaseMissing(f"{family / 'mapping' / 'devices.yaml'} does not say which die {part} has")
