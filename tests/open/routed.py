# SPDX-License-Identifier: Apache-2.0
"""A module through other people's tools: synthesised, placed and routed between anchors, without a manager in sight."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from cm.design.debian_packages import PackageTree
from cm.formats.xray import Database, Feature, encode, read_features
from cm.simulation.bits import Boundary, Netlist, Port, verilog

HERE = Path(__file__).parent
PART = "xc7z010clg400-1"
TOOLS = ["nextpnr-himbaechel-xilinx", "nextpnr-himbaechel-xilinx-chipdb", "prjxray", "prjxray-database", "yosys"]
_LETTERS = "ABCD"


@dataclass(frozen=True)
class Routed:
    """What nextpnr made of `hdl/everything.v`."""

    folder: Path
    database: Database

    @cached_property
    def features(self) -> frozenset[Feature]:
        """As it wrote them."""
        return read_features((self.folder / "harness.fasm").read_text().splitlines())

    @cached_property
    def frames(self) -> dict[int, int]:
        """The same as frames."""
        encoded = encode(self.database, self.features)
        assert not encoded.unresolved
        assert not encoded.clashes
        return dict(encoded.frames)

    @cached_property
    def netlist(self) -> dict[str, Any]:
        """The module of its own routed design: cells, their places, and the route of each net."""
        found: dict[str, Any] = json.loads((self.folder / "routed.json").read_text())["modules"]["top"]
        return found

    @cached_property
    def routes(self) -> dict[str, Any]:
        """What dump_routes.py has written."""
        found: dict[str, Any] = json.loads((self.folder / "routes.json").read_text())
        return found

    @cached_property
    def boundary(self) -> Boundary:
        """Where place_anchors.py has put the anchors."""
        inputs = {self._place(84, bit): f"a[{bit}]" for bit in range(8)}
        return Boundary(inputs, {f"y[{bit}]": self._place(87, bit) for bit in range(8)})

    def _place(self, column: int, bit: int) -> tuple[str, str, str]:
        tile = self.database.tile_at[column, 12 + bit // 4]
        first = min(tile.sites, key=lambda name: int(name.partition("_X")[2].partition("Y")[0]))
        return tile.name, f"{tile.sites[first]}_X0", _LETTERS[bit % 4]


def as_verilog(netlist: Netlist) -> str:
    """A module `design@` that does what the bits say."""
    ports = (Port("clk", 1, True), Port("a", 8, True), Port("y", 8, False))
    return verilog(netlist, "design@", ports, dict.fromkeys(range(12), "clk"))


def route(packages: PackageTree, folder: Path, seed: int = 1) -> Routed:
    """Run yosys and nextpnr in a folder."""
    database = Database.open(PART, packages.path("usr/share/prjxray/database"))
    constraints = "set_property LOC K17 [get_ports clk]\nset_property IOSTANDARD LVCMOS33 [get_ports clk]\n"
    (folder / "clk.xdc").write_text(constraints)
    sources = " ".join(str(HERE / "hdl" / name) for name in ("harness.v", "everything.v"))
    flow = "synth_xilinx -family xc7 -flatten -nodsp -nobram -top harness"
    yosys = ["yosys", "-q", "-p", f"read_verilog {sources}; {flow}; write_json harness.json"]
    subprocess.run(yosys, check=True, cwd=folder, capture_output=True)
    chip = next(packages.path("usr/share/nextpnr").rglob("chipdb-xc7z010.bin"))
    options = {
        "--device": PART,
        "--chipdb": str(chip),
        "--json": "harness.json",
        "--seed": str(seed),
        "--pre-place": str(HERE / "place_anchors.py"),
        "--post-route": str(HERE / "dump_routes.py"),
        "--write": "routed.json",
    }
    words = [word for option in options.items() for word in option]
    words += ["-o", "xdc=clk.xdc", "-o", "fasm=harness.fasm", "-q"]
    environment = {**os.environ, "PYTHONHOME": str(packages.path("usr"))}
    command = packages.command("nextpnr-himbaechel-xilinx", *words)
    subprocess.run(command, check=True, cwd=folder, env=environment, capture_output=True)
    return Routed(folder, database)
