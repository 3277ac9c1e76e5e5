# SPDX-License-Identifier: Apache-2.0
"""The process of a simulated board whose logic is RTL: compile, start the engine, serve the nodes."""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from cm.errors import CmError
from cm.rtl.compile import compile_engine, compile_units
from cm.rtl.design import RtlDesign, load_rtl_design, wiring
from cm.rtl.errors import ToolMissing
from cm.rtl.logic import RtlLogic
from cm.rtl.process import EngineProcess
from cm.rtl.tools import Tools, find_tools
from cm.sim.hardware.logic import LogicParts, MakeLogic, SoftwareLogic
from cm.sim.process.arguments import add_arguments
from cm.sim.process.main import run as run_board


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m cm.rtl``; the exit status."""
    parser = argparse.ArgumentParser("python -m cm.rtl", description="a simulated board whose logic is a design's RTL")
    add_arguments(parser)
    parser.add_argument("--build", type=Path, default=example_build(), metavar="FILE",
        help="build schema (default: the shipped camera)")  # fmt: skip
    parser.add_argument("--traces", action="store_true", help="compiled so that traces can be written (slower)")
    logging.basicConfig(level=logging.WARNING, format="cm sim: %(message)s")
    return run(parser.parse_args(argv))


def run(args: argparse.Namespace) -> int:
    """Serve until a signal or the linger time ends it."""
    with tempfile.TemporaryDirectory(prefix="cm-rtl-") as folder:
        try:
            design = load_rtl_design(args.build, Path(folder))
            start = _maker(design, Path(folder), args.traces)
            if not args.config:
                args.config = [_schema(design, Path(folder))]
        except CmError as error:
            print(f"cm sim: {error}", file=sys.stderr)
            return 1
        return run_board(args, start)


def prepare(build: Path, traces: bool = False) -> None:
    """Compile what a design needs, so that a board that runs it starts at once. Raises as `load_rtl_design`."""
    tools = find_tools()
    with tempfile.TemporaryDirectory(prefix="cm-rtl-") as folder:
        design = load_rtl_design(build, Path(folder))
        compile_units(tools, [design.static, *design.modules.values()], traces)
    compile_engine(tools)


def example_build() -> Path:
    """The build schema of the camera that comes with the package."""
    return Path(__file__).parents[1] / "data/examples/camera/build.yaml"


def _schema(design: RtlDesign, folder: Path) -> Path:
    return folder / "config" / f"{design.system.project.name}.yaml"


def _maker(design: RtlDesign, folder: Path, traces: bool) -> MakeLogic:
    """What makes the logic; the models in software where nothing here compiles HDL."""
    try:
        tools = find_tools()
    except ToolMissing as error:
        logging.getLogger(__name__).warning("the RTL %s; models in software stand in for it", error)
        return SoftwareLogic
    return partial(_start, tools, design, folder, traces)


def _start(tools: Tools, design: RtlDesign, folder: Path, traces: bool, parts: LogicParts) -> RtlLogic:
    static, *libraries = compile_units(tools, [design.static, *design.modules.values()], traces)
    lines = folder / "wiring"
    lines.write_text(wiring(design, static, parts.seed), encoding="utf-8")
    process = EngineProcess(compile_engine(tools), lines)
    return RtlLogic(parts, design, process, dict(zip(design.modules, libraries, strict=True)))
