# SPDX-License-Identifier: Apache-2.0
"""``cm build check``: what was found in the HDL, and how the modules fit their regions."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.build import add_schema_argument
from cm.cli.common import add_json_option, answer
from cm.design.boundary.analyse import analyse
from cm.design.check.rules import check_system
from cm.design.plan.planner import plan_system
from cm.design.project.load import load_project
from cm.design.project.source_position import OPEN_FLOW, Finding
from cm.design.report import as_dict, lines
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import runtime_config


def fill_check(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    add_schema_argument(parser)
    parser.add_argument(
        "--flow", choices=("vivado", "open"), default="vivado", help="which tools' limits to check (default: vivado)"
    )
    parser.add_argument(
        "--image",
        type=Path,
        metavar="FILE.dtb",
        help="the device tree of a board's image (/sys/firmware/fdt there): what the design's overlays clash with",
    )
    add_json_option(parser, run_check)


def run_check(args: argparse.Namespace) -> int:
    """Print the report; 1 if a module does not fit, or cannot be synthesised."""
    project = load_project(args.schema)
    analysis = analyse(project)
    system = None if analysis.refused else plan_system(analysis.completed(project), analysis.boundaries)
    if system is not None:
        runtime_config(system, Answers())  # raises where registers have no interface, or a mode names no stream
    found = check_system(system) if system is not None else []
    if system is not None and args.flow == "open":
        from cm.design.openflow.rules import (
            check_open,  # here: the open tools' limits take their database's readers along
        )

        found += check_open(system)
        if not any(finding.error for finding in found):
            from cm.design.openflow.relocatable_modules import check_moved

            found += check_moved(system)
    if system is not None and args.image is not None:
        from cm.design.collect.stock_image import check_image

        found += check_image(system, args.image)
    told = [{"rule": f.rule, "error": f.error, "message": f.text(project.source)} for f in found]
    text = [*lines(project, analysis, system), *(f"{_judge(f)}: {f.text(project.source)}" for f in found)]
    answer(args, as_dict(project, analysis, system) | {"findings": told}, "\n".join(text))
    return 1 if analysis.refused or analysis.broken or any(finding.error for finding in found) else 0


def _judge(finding: Finding) -> str:
    if not finding.error:
        return "note"
    if finding.rule == "image":
        return "clashes with the image"
    return "refused by the open tools" if finding.rule == OPEN_FLOW else "would be refused"
