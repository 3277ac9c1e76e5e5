# SPDX-License-Identifier: Apache-2.0
"""``cm build run --flow open`` and ``cm build tools``: without a vendor's tool."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.common import add_json_option, print_json
from cm.design.errors import BuildError
from cm.design.generate.tree import behind, load_design
from cm.design.openflow.attempt import Settings
from cm.design.openflow.flow import OpenFlow
from cm.design.openflow.rules import refuse_open
from cm.design.openflow.tools import Tools, fetch_tools, find_tools


def add_tools_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "tools",
        help="show which open tools are found, or fetch them",
        description="Show which yosys, nextpnr and Project X-Ray database cm build run --flow open "
        "would use: those on PATH, otherwise those that --fetch downloaded from Debian's "
        "packages (some 50 MB, verified with apt's signed lists; without root, nothing is"
        " compiled or installed).",
    )
    parser.add_argument("--fetch", action="store_true", help="fetch what is missing")
    parser.add_argument("--tools", type=Path, metavar="DIR", help="folder for them (default: in your cache folder)")
    parser.add_argument("--mirror", metavar="URL", help="Debian mirror (default: the one that this machine uses)")
    add_json_option(parser)
    parser.set_defaults(run=run_tools)


def run_tools(args: argparse.Namespace) -> int:
    """Fetch if asked to, and say what is installed."""
    found = fetch_tools(args.tools, args.mirror) if args.fetch else find_tools(args.tools)
    if args.json:
        print_json(_dict(found))
        return 0
    for tool in (found.yosys, found.nextpnr):
        print(f"{tool.name}: {tool.command[-1]}")
    print(f"database of Project X-Ray: {found.database}")
    return 0


def run_open(args: argparse.Namespace, out: Path) -> int:
    """Run the flow over what was generated in `out`."""
    design = load_design(args.schema)
    refuse_open(design.system)
    names = behind(design, out)
    if names:
        raise BuildError(f"{names[0]} in {out} would be generated otherwise now: run cm build generate first")
    if args.dry_run:
        raise BuildError("--dry-run is of the flow in Vivado; the open flow says what it does while it runs")
    tell = (lambda _: None) if args.json else _tell
    flow = OpenFlow(design.system, out, find_tools(args.tools), tell, Settings(seed=args.seed, jobs=max(1, args.jobs)))
    ran = flow.run()
    if args.json:
        print_json({"ran": ran, "bitstreams": out / "bitstreams"})
    elif not ran:
        print("nothing to do: all steps are done and their inputs unchanged")
    return 0


def _tell(sentence: str) -> None:
    print(sentence, flush=True)


def _dict(tools: Tools) -> dict[str, object]:
    return {
        "yosys": tools.yosys.command[-1],
        "nextpnr": tools.nextpnr.command[-1],
        "database": tools.database,
        "packages": dict(tools.versions),
    }
