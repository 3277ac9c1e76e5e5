# SPDX-License-Identifier: Apache-2.0
"""Netlist → features, routes and a timing report, by nextpnr."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.design.openflow.merge import Side
from cm.design.openflow.routed import read_routed
from cm.design.openflow.shifts import with_contents
from cm.design.openflow.steps import run_tool
from cm.design.openflow.timing import Timing, read_timing
from cm.design.openflow.tools import Tool
from cm.formats.xray import Database, read_features

INSIDE = Path(__file__).parent / "inside"
_LONGEST = 300  # seconds of processor time: with too few routes, the router runs for hours
SCRIPTS = tuple(INSIDE / f"{name}.py" for name in ("place", "block", "dump"))


@dataclass(frozen=True, slots=True)
class Files:
    """The files of one run, by its name, in a folder."""

    folder: Path
    name: str

    def file(self, ending: str) -> Path:
        """A file of the run."""
        return self.folder / f"{self.name}.{ending}"

    @property
    def outputs(self) -> tuple[Path, ...]:
        """The files that a run writes."""
        return tuple(self.file(ending) for ending in ("fasm", "route.json", "report.json"))


def place_and_route(
    nextpnr: Tool, part: str, files: Files, job: Mapping[str, Any], xdc: str, megahertz: float, seed: int
) -> None:
    """Run nextpnr on ``<name>.json``. Raises OpenStepFailed, OpenStepEndless. The caller judges the timing."""
    told = {**job, "result": str(files.file("route.json"))}
    files.file("job.json").write_text(json.dumps(told), encoding="utf-8")
    files.file("xdc").write_text(xdc or "\n", encoding="utf-8")
    place, block, dump = map(str, SCRIPTS)
    options = ["--device", part, "--json", str(files.file("json")), "--seed", str(seed)]
    options += ["--freq", f"{megahertz:g}", "--router", "router2", "--timing-allow-fail", "--quiet"]
    options += ["--pre-place", place, "--pre-route", block, "--post-route", dump, "--detailed-timing-report"]
    options += ["--report", str(files.file("report.json")), "--log", str(files.file("nextpnr.log"))]
    options += ["-o", f"xdc={files.file('xdc')}", "-o", f"fasm={files.file('fasm')}"]
    environment = {"CM_OPEN_JOB": str(files.file("job.json"))}
    run_tool(nextpnr, options, files.file("nextpnr.out"), environment, f"{files.name}, seed {seed}", seconds=_LONGEST)


def read_side(database: Database, files: Files, inputs: frozenset[str], static: bool) -> Side:
    """Read the result of a run; `inputs`: labels of the anchors whose input side it contains."""
    lines = files.file("fasm").read_text("utf-8").splitlines()
    routed = read_routed(files.file("route.json"), inputs)
    features = with_contents(read_features(lines, str(files.file("fasm"))), database, cells_of(files), routed.cells)
    return Side(features, routed, static)


def cells_of(files: Files) -> dict[str, Any]:
    """The cells of the netlist of a run, by name."""
    modules = json.loads(files.file("json").read_text("utf-8"))["modules"].values()
    return {name: cell for module in modules for name, cell in module.get("cells", {}).items()}


def timing(files: Files) -> Timing:
    """Read nextpnr's timing report of a run."""
    return read_timing(files.file("report.json"))
