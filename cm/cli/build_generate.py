# SPDX-License-Identifier: Apache-2.0
"""``cm build check`` and ``cm build generate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.build_common import add_out_option, add_schema_argument
from cm.cli.common import add_json_option, print_json
from cm.design.boundary.analyse import analyse
from cm.design.check.rules import check_system
from cm.design.generate.manifest import Written
from cm.design.generate.tree import generate, load_design, output_folder
from cm.design.openflow.rules import RULE, check_open
from cm.design.plan.planner import plan_system
from cm.design.project.load import load_project
from cm.design.project.source_position import Finding
from cm.design.report import as_dict, lines
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import runtime_config


def add_check_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``check``."""
    parser = actions.add_parser("check", help="report what was found in the HDL, and how the modules fit their regions")
    add_schema_argument(parser)
    parser.add_argument(
        "--flow", choices=("vivado", "open"), default="vivado", help="which tools' limits to check (default: vivado)"
    )
    add_json_option(parser)
    parser.set_defaults(run=run_check)


def add_generate_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add ``generate``."""
    parser = actions.add_parser(
        "generate",
        help="write wrappers, static part, Tcl, overlays, symbols and the runtime schema",
        description="Write everything that the vendor's tools and the target need. A file that you "
        "changed is never overwritten: the new version is written beside it as FILE.new, "
        "and the version that you started from is kept in .cm-orig/.",
    )
    add_schema_argument(parser)
    add_out_option(parser)
    add_json_option(parser)
    parser.set_defaults(run=run_generate)


def run_check(args: argparse.Namespace) -> int:
    """Print the report; 1 if a module does not fit, or cannot be synthesised."""
    project = load_project(args.schema)
    analysis = analyse(project)
    system = None if analysis.refused else plan_system(analysis.completed(project), analysis.boundaries)
    if system is not None:
        runtime_config(system, Answers())  # raises where registers have no interface, or a mode names no stream
    found = check_system(system) if system is not None else []
    if system is not None and args.flow == "open":
        found += check_open(system)
    if args.json:
        told = [{"rule": f.rule, "error": f.error, "message": f.text(project.source)} for f in found]
        print_json(as_dict(project, analysis, system) | {"findings": told})
    else:
        for line in lines(project, analysis, system):
            print(line)
        for finding in found:
            print(f"{_judge(finding)}: {finding.text(project.source)}")
    return 1 if analysis.refused or analysis.broken or any(finding.error for finding in found) else 0


def _judge(finding: Finding) -> str:
    if not finding.error:
        return "note"
    return "refused by the open tools" if finding.rule == RULE else "would be refused"


def run_generate(args: argparse.Namespace) -> int:
    """Write the files; 1 if some could not be brought up to date without losing changes."""
    design = load_design(args.schema)
    out = output_folder(design.project, args.out)
    done = generate(design, out)
    if args.json:
        print_json({name: getattr(done, name) for name in Written.__slots__} | {"runs": len(design.system.runs)})
        return 1 if done.conflicts else 0
    print(f"{out}: {len(done.created)} new, {len(done.updated)} updated, {len(done.unchanged)} unchanged")
    _print_changes(done, out)
    print(design.system.cover)
    for name, info in design.analysis.modules.items():
        for problem in info.problems:
            print(f"problem of {name}: {problem}")
    for note in design.system.notes:
        print(f"note: {note}")
    return 1 if done.conflicts else 0


def _print_changes(done: Written, out: Path) -> None:
    for name in done.kept:
        print(f"kept your changes: {name}")
    for name in done.conflicts:
        print(f"changed by you and by generation: {name}")
        print(f"  the new text is in {name}.new; merge: git -C {out} merge-file {name} .cm-orig/{name} {name}.new")
    for name in done.removed:
        print(f"removed, no longer generated: {name}")
    for name in done.left:
        print(f"no longer generated, left because you changed it: {name}")
