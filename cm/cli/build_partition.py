# SPDX-License-Identifier: Apache-2.0
"""``cm build partition``: which modules should share a region."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cm.cli.build import add_schema_argument
from cm.cli.common import add_json_option, digits, naming, parsed, print_json, print_table
from cm.design.boundary.analyse import analyse
from cm.design.errors import BuildError
from cm.design.generate.generation import output_folder
from cm.design.partition.advisor import SECONDS
from cm.design.partition.from_project import problem_of, todays_groups
from cm.design.partition.model import Partition, evaluate
from cm.design.partition.proposal import proposal
from cm.design.partition.utilisation import read_utilisation, static_report, with_reports
from cm.design.project.load import load_project


def fill_partition(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = (
        "Propose which modules should share a region, so that the worst or the mean time "
        "of a change of mode is smallest within the device's resources, and compare it "
        "with the present assignment. Needs the modes, and the resources of each module: "
        "from `resources:` in the build schema, else from Vivado's utilisation report."
    )
    percent = parsed("a number above 0 and at most 100", lambda s: float(s.removesuffix("%")), lambda v: 0 < v <= 100)
    count = parsed("a number of regions", digits, lambda value: value > 0)
    seconds = parsed("a time in seconds", float, lambda value: 0 < value < 1e6)
    add_schema_argument(parser)
    parser.add_argument("--objective", choices=("worst", "mean"), default="worst", help="default: worst")
    parser.add_argument(
        "--budget",
        type=percent,
        default=100.0,
        metavar="PERCENT",
        help="how much of the device all regions may take together (default: what the static part leaves)",
    )
    parser.add_argument("--regions", type=count, metavar="N", help="at most N regions")
    parser.add_argument(
        "--seconds",
        type=seconds,
        default=SECONDS,
        help=f"stop after this time with the best result so far (default: {SECONDS:g})",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="write the proposal as a build schema, into the folder of this one",
    )
    add_json_option(parser, run_partition)


def run_partition(args: argparse.Namespace) -> int:
    """Print both assignments with their figures."""
    project = load_project(args.schema)
    folders = [output_folder(project, None) / "reports"]
    project, reports = with_reports(project, folders)
    path = static_report(folders)
    static = read_utilisation(path) if path else None
    analysis = analyse(project)
    problem = problem_of(project, analysis, None, static, args.budget / 100, args.regions)
    if path is not None:
        reports |= {"static part": path}
    today = evaluate(problem, todays_groups(project, problem))
    found = proposal(project, analysis, problem, args.objective, args.seconds)
    proposed, gap = found.partition, found.partition.gap(args.objective)
    if args.output:
        _write(args.output, project.folder, found.text)
    if args.json:
        said = {"objective": args.objective, "today": _dict(today), "proposed": _dict(proposed) | {"gap": gap}}
        said |= {"notes": found.notes, "reports": {name: str(path) for name, path in reports.items()}}
        print_json(said)
        return 0
    for name, path in reports.items():
        print(f"{name}: resources from {path}")
    for title, partition in (("today", today), ("proposed", proposed)):
        _print(title, partition)
    for note in found.notes:
        print(f"note: {note}")
    among = f" of at most {len(proposed.groups)} regions" if found.notes else ""
    print(f"at most {gap:.1%} from the best there is{among}" if gap else f"no other partition{among} is better")
    if args.output:
        print(f"{args.output}: the proposal as a build schema")
    return 0


def _write(path: Path, folder: Path, text: str) -> None:
    """A new file beside the build schema, whose paths are relative to that folder."""
    if path.absolute().parent.resolve() != folder.resolve():
        raise BuildError(f"{path} must lie in {folder}: paths in a build schema are relative to its folder")
    if path.exists():
        raise BuildError(f"{path} exists already: name another file, or move it away")
    with naming(path):
        path.write_text(text, encoding="utf-8")


def _dict(found: Partition) -> dict[str, Any]:
    return {
        "regions": [{"modules": g.modules, "share": g.share, "bytes": g.bytes} for g in found.groups],
        "worst_seconds": found.worst,
        "worst_change": found.worst_change,
        "mean_seconds": found.mean,
        "share": found.share,
        "fits": found.fits,
    }


def _print(title: str, found: Partition) -> None:
    change = " to ".join(found.worst_change) if found.worst else "no change loads anything"
    fits = "" if found.fits else ", which does not fit"
    print(f"{title}: worst {found.worst * 1e3:.3f} ms ({change}), mean {found.mean * 1e3:.3f} ms", end="")
    print(f", {found.share:.1%} of the part{fits}")
    rows = [
        (
            index,
            ", ".join(g.modules),
            g.resources.lut,
            g.resources.ff,
            g.resources.bram,
            g.resources.dsp,
            f"{g.bytes:,}",
        )
        for index, g in enumerate(found.groups)
    ]
    print_table(rows, ("region", "modules", "LUT", "FF", "BRAM", "DSP", "bytes of a load"))
    print()
