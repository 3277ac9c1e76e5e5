# SPDX-License-Identifier: Apache-2.0
"""Netlist → features, routes and a timing report, by nextpnr.

Whether paths meet their clock: within each run by nextpnr's report, across anchors by the sum of both sides.

In each run the harness represents the other side, on its own clock. A path across an anchor is at most as long as
the longest path to the harness on one side plus the longest from it on the other; both include the anchor, so the
sum is on the safe side.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.design.openflow.merge import Side
from cm.design.openflow.netlists import HARNESS
from cm.design.openflow.rewrites import with_contents
from cm.design.openflow.routed import read_routed
from cm.design.openflow.steps import run_tool
from cm.design.openflow.tools import Tool
from cm.formats.xray import Database, read_features

_CLOCK = "cm_toggle_clock"


@dataclass(frozen=True, slots=True)
class Timing:
    """Delays in ns of one run: the longest path on its clock, to the harness, from it, and from it to it."""

    inside: float
    leaving: float
    arriving: float
    through: float


def read_timing(path: Path) -> Timing:
    """Read nextpnr's report. Raises OSError, ValueError."""
    report = json.loads(path.read_text(encoding="utf-8"))
    longest = {(False, False): 0.0, (False, True): 0.0, (True, False): 0.0, (True, True): 0.0}
    for net in report["detailed_net_timings"]:
        for end in net["endpoints"]:
            if not _counts(net, end):
                continue
            way = _CLOCK in net["event"], _CLOCK in end["event"]
            longest[way] = max(longest[way], end["delay"][-1])
    rates = [entry["achieved"] for name, entry in report["fmax"].items() if _CLOCK not in name]
    return Timing(1000 / min(rates) if rates else 0.0, longest[False, True], longest[True, False], longest[True, True])


def slacks(static: Timing, module: Timing, period: float) -> dict[str, float]:
    """Return the slack in ns of each kind of path at this period (ns); a negative one is a violation."""
    found = {
        "static part": static.inside,
        "module": module.inside,
        "static part to module": static.leaving + module.arriving,
        "module to static part": module.leaving + static.arriving,
    }
    if module.through:
        found["static part through module"] = static.leaving + module.through + static.arriving
    if static.through:
        found["module through static part"] = module.leaving + static.through + module.arriving
    if module.through and static.through:
        found["through both"] = static.leaving + module.through + static.through + module.arriving
    return {what: period - delay for what, delay in found.items()}


def _counts(net: dict[str, Any], end: dict[str, Any]) -> bool:
    """Whether a path counts: not the harness's own clock divider, nor a path without a clock on either side."""
    if "async" in net["event"] or "async" in end["event"]:
        return False
    own = end["cell"].rpartition(".")[2]
    return not (own.startswith(HARNESS) and ("_toggle" in own or "_spine" in own))


INSIDE = Path(__file__).parent / "nextpnr_scripts"
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
    """Run nextpnr on ``<name>.json``. Raises StepFailed, OpenStepEndless. The caller judges the timing."""
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
