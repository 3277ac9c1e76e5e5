# SPDX-License-Identifier: Apache-2.0
"""``cm build run``: run the vendor's flow."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from cm.cli.build_common import add_out_option, add_schema_argument
from cm.cli.build_open import run_open
from cm.cli.common import add_json_option, print_json, print_table
from cm.design.errors import BuildError, MissingTool
from cm.design.generate.tree import behind, load_design, output_folder
from cm.design.hdl.errors import ParserMissing
from cm.design.project.load import load_project
from cm.design.run.make import run_flow
from cm.design.run.steps import Flow, Planned, State
from cm.design.run.vivado import find_vivado


def add_run_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "run",
        help="run the flow, in Vivado or with open tools, as far as inputs have changed",
        description="Run the generated flow. Steps whose inputs are unchanged are skipped; after an "
        "error or an interruption, the next run continues where this one stopped. --flow "
        "open uses yosys, nextpnr and Project X-Ray's database instead of Vivado "
        "(docs/open-flow.md).",
    )
    add_schema_argument(parser)
    add_out_option(parser)
    parser.add_argument("--flow", choices=("vivado", "open"), default="vivado", help="default: vivado")
    parser.add_argument("--vivado", metavar="PATH", help="the program or its folder (default: XILINX_VIVADO, PATH)")
    parser.add_argument(
        "-j", "--jobs", type=int, default=2, metavar="N", help="how many steps may run at the same time (default: 2)"
    )
    more = "only what this module's bitstream needs (may be repeated)"
    parser.add_argument("--module", action="append", default=[], metavar="NAME", help=more)
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed for nextpnr; the same seed gives the same bits"
    )
    parser.add_argument("--tools", type=Path, metavar="DIR", help="folder that cm build tools --fetch filled")
    parser.add_argument("--dry-run", action="store_true", help="list the steps, and which of them would run")
    add_json_option(parser)
    parser.set_defaults(run=run_run)


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
    except (
        ParserMissing,
        MissingTool,
    ):  # a machine that has Vivado and not the extra `build`: nothing can be generated here
        return ""
    few = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"{few} in {out} would be generated otherwise now: run cm build generate first" if names else ""


def _tell(sentence: str) -> None:
    print(sentence, flush=True)


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
