# SPDX-License-Identifier: Apache-2.0
"""``cm build run|tools|pack|unpack``: the flow, here in Vivado or with open tools, or on another host."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from cm.cli.build import add_out_option, add_schema_argument
from cm.cli.common import add_json_option, answer, positive, print_json, print_table
from cm.design.errors import BuildError, MissingTool
from cm.design.generate.generation import behind, load_design, output_folder
from cm.design.hdl.errors import ParserMissing
from cm.design.openflow.flow import OpenFlow
from cm.design.openflow.placement_attempt import Settings
from cm.design.openflow.rules import refuse_open
from cm.design.openflow.tools import fetch_tools, find_tools
from cm.design.project.load import load_project
from cm.design.run.flow import Flow, Planned, State
from cm.design.run.make import run_flow
from cm.design.run.vivado import find_vivado


def fill_tools(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = (
        "Show which yosys, nextpnr and Project X-Ray database cm build run --flow open "
        "would use: those on PATH, otherwise those that --fetch downloaded from Debian's "
        "packages (some 50 MB, verified with apt's signed lists; without root, nothing is"
        " compiled or installed)."
    )
    parser.add_argument("--fetch", action="store_true", help="fetch what is missing")
    parser.add_argument("--mirror", metavar="URL", help="Debian mirror (default: the one that this machine uses)")
    add_json_option(parser, run_tools)


def run_tools(args: argparse.Namespace) -> int:
    """Fetch if asked to, and say what is installed."""
    found = fetch_tools(mirror=args.mirror) if args.fetch else find_tools()
    yosys, nextpnr = found.yosys.command[-1], found.nextpnr.command[-1]
    told = {"yosys": yosys, "nextpnr": nextpnr, "database": found.database, "packages": dict(found.versions)}
    lines = [f"{tool.name}: {tool.command[-1]}" for tool in (found.yosys, found.nextpnr)]
    return answer(args, told, "\n".join([*lines, f"database of Project X-Ray: {found.database}"]))


def run_open(args: argparse.Namespace, out: Path) -> int:
    """Run the flow over what was generated in `out`."""
    design = load_design(args.schema)
    refuse_open(design.system)
    refuse_stale(behind(design, out)[:1], out)
    if args.dry_run:
        raise BuildError("--dry-run is of the flow in Vivado; the open flow says what it does while it runs")
    tell = (lambda _: None) if args.json else _tell
    flow = OpenFlow(design.system, out, find_tools(), tell, Settings(seed=args.seed, jobs=max(1, args.jobs)))
    ran = flow.run()
    if args.json:
        print_json({"ran": ran, "bitstreams": out / "bitstreams"})
    elif not ran:
        print("nothing to do: all steps are done and their inputs unchanged")
    return 0


def refuse_stale(names: Sequence[str], out: Path) -> None:
    """Raise BuildError where some generated files are not those of the present build schema and HDL."""
    if names:
        raise BuildError(_otherwise(names, out))


def _otherwise(names: Sequence[str], out: Path) -> str:
    return f"{', '.join(names)} in {out} would be generated otherwise now: run cm build generate first"


def _tell(sentence: str) -> None:
    print(sentence, flush=True)


def fill_run(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = (
        "Run the generated flow. Steps whose inputs are unchanged are skipped; after an "
        "error or an interruption, the next run continues where this one stopped. --flow "
        "open uses yosys, nextpnr and Project X-Ray's database instead of Vivado "
        "(docs/open-flow.md)."
    )
    add_schema_argument(parser)
    add_out_option(parser)
    parser.add_argument("--flow", choices=("vivado", "open"), default="vivado", help="default: vivado")
    parser.add_argument("--vivado", metavar="PATH", help="the program or its folder (default: XILINX_VIVADO, PATH)")
    parser.add_argument(
        "-j",
        "--jobs",
        type=positive,
        default=2,
        metavar="N",
        help="how many steps may run at the same time (default: 2)",
    )
    more = "only what this module's bitstream needs (may be repeated)"
    parser.add_argument("--module", action="append", default=[], metavar="NAME", help=more)
    parser.add_argument(
        "--seed",
        type=int,
        default=1,
        metavar="N",
        help="seed for nextpnr (default: 1); the same seed gives the same bits",
    )
    parser.add_argument("--dry-run", action="store_true", help="list the steps, and which of them would run")
    add_json_option(parser, run_run)


def run_run(args: argparse.Namespace) -> int:
    """Run or list the steps."""
    project = load_project(args.schema)
    out = output_folder(project, args.out)
    if args.flow == "open":
        return run_open(args, out)
    planned = Flow(out).plan(args.module)
    stale = _stale(args.schema, out)
    if args.dry_run:
        _print_plan(planned, stale, args.json)
        return 0
    if stale:
        raise BuildError(stale)
    vivado = find_vivado(args.vivado, os.environ, project.vivado)
    planned = run_flow(out, vivado, max(1, args.jobs), (lambda _: None) if args.json else _tell, args.module)
    if args.json:
        print_json({"ran": [entry.step.name for entry in planned if entry.state is not State.DONE]})
    return 0


def _stale(schema: Path, out: Path) -> str:
    """A sentence if the generated files are not those of the present build schema and HDL."""
    try:
        names = behind(load_design(schema), out)
    except (ParserMissing, MissingTool):  # with Vivado and without the extra `build`, nothing can be generated here
        return ""
    last = [f"{names[2]} and {len(names) - 3} more"] if len(names) > 3 else names[2:]
    return _otherwise([*names[:2], *last], out) if names else ""


def _print_plan(planned: Sequence[Planned], stale: str, as_json: bool) -> None:
    if as_json:
        rows = [{"step": p.step.name, "title": p.step.title, "state": p.state.value} for p in planned]
        print_json({"steps": rows, "notes": [stale] if stale else []})
        return
    if stale:
        print(f"note: {stale}")
    words = {
        State.DONE: "done",
        State.NEW: "to run",
        State.CHANGED: "to run: its inputs changed",
        State.AFTER: "to run: a step before it runs",
        State.LOST: "to run: an output is gone",
    }
    print_table([(p.step.name, words[p.state], p.step.title) for p in planned], ("step", "state", "what"))
