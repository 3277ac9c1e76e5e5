# SPDX-License-Identifier: Apache-2.0
"""The process of a simulated board whose logic is RTL: compile, start the harness, serve the nodes."""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

from cm.errors import CmError
from cm.simulation.rtl.compile import NOTHING, Watched, compile_harness, compile_units
from cm.simulation.rtl.design import RtlDesign, load_rtl_design, wiring
from cm.simulation.rtl.errors import RtlError, ToolMissing
from cm.simulation.rtl.logic import RtlLogic
from cm.simulation.rtl.process import HarnessProcess, Op
from cm.simulation.rtl.running_design import Libraries, Library, of_modules
from cm.simulation.rtl.tools import Tools, find_tools
from cm.simulation.software.hardware.logic import LogicParts, MakeLogic, SoftwareLogic
from cm.simulation.software.process.arguments import add_arguments
from cm.simulation.software.process.main import failed
from cm.simulation.software.process.main import run as run_board
from cm.simulation.software.transport.scratch import Scratch, temporary


class Made(NamedTuple):
    """What runs in regions, and by its name for messages each library whose HDL reads files."""

    libraries: Libraries
    reading: Mapping[str, Library]


MakeLibraries: TypeAlias = Callable[[Tools, RtlDesign, Watched, LogicParts], Made]


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m cm.simulation.rtl``; the exit status."""
    parser = argparse.ArgumentParser(
        "python -m cm.simulation.rtl", description="a simulated board whose logic is a design's RTL"
    )
    add_rtl_arguments(parser)
    logging.basicConfig(level=logging.WARNING, format="cm sim: %(message)s")
    return run(parser.parse_args(argv))


def add_rtl_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `cm.simulation.software`, and those for HDL."""
    add_arguments(parser)
    parser.add_argument("--build", type=Path, default=example_build(), metavar="FILE",
        help="build schema (default: the shipped camera)")  # fmt: skip
    parser.add_argument("--traces", action="store_true", help="let traces be recorded (slower)")


def run(args: argparse.Namespace, make: MakeLibraries | None = None) -> int:
    """Serve until a signal or the linger time ends it. `make` says what runs in regions (default: modules)."""
    with Scratch("cm-rtl-", temporary()) as folder:
        try:
            design = load_rtl_design(args.build, folder)
            args.vdma = [*args.vdma, *design.video]
            start = _maker(design, folder, args, make or _modules)
            if not args.config:
                args.config = [_schema(design, folder)]
        except ToolMissing as error:
            return failed(f"the RTL {error}", args)
        except (CmError, OSError) as error:
            return failed(error, args)
        return run_board(args, start)


def prepare(build: Path, watched: Watched = NOTHING) -> None:
    """Compile what a design needs, so that a board that runs it starts at once. Raises as `load_rtl_design`."""
    tools = find_tools()
    with Scratch("cm-rtl-", temporary()) as folder:
        design = load_rtl_design(build, folder)
        compile_units(tools, [design.static, *design.modules.values()], watched)
    compile_harness(tools)


def example_build() -> Path:
    """The build schema of the camera that comes with the package."""
    return Path(__file__).parents[2] / "data/examples/camera/build.yaml"


def _schema(design: RtlDesign, folder: Path) -> Path:
    return folder / "config" / f"{design.system.project.name}.yaml"


def _maker(design: RtlDesign, folder: Path, args: argparse.Namespace, make: MakeLibraries) -> MakeLogic:
    """The function that makes the logic; of software models if no compiler for HDL is installed."""
    try:
        tools = find_tools()
    except ToolMissing as error:
        logging.getLogger(__name__).warning("the RTL %s; models in software are used instead", error)
        return SoftwareLogic
    return partial(_start, tools, design, folder, args, make)


def _modules(tools: Tools, design: RtlDesign, watched: Watched, parts: LogicParts) -> Made:  # noqa: ARG001
    libraries = compile_units(tools, design.modules.values(), watched)
    found = [Library(path, unit.folders) for unit, path in zip(design.modules.values(), libraries, strict=True)]
    reading = {unit.name: one for unit, one in zip(design.modules.values(), found, strict=True) if unit.reads_files}
    return Made(of_modules(dict(zip(design.modules, found, strict=True))), reading)


def _start(
    tools: Tools, design: RtlDesign, folder: Path, args: argparse.Namespace, make: MakeLibraries, parts: LogicParts
) -> RtlLogic:
    watched = Watched(args.traces)
    (static,) = compile_units(tools, [design.static], watched)
    made = make(tools, design, watched, parts)
    lines = folder / "wiring"
    lines.write_text(wiring(design, static, 1), encoding="utf-8")
    process = HarnessProcess(compile_harness(tools), lines)
    try:
        for name, library in made.reading.items():  # zeros in place of a file would make another module of it
            answer = process.ask(Op.TRY, text=library.text)
            if answer.a:
                raise RtlError(f"{name}: {answer.text}")
    except BaseException:
        process.close()
        raise
    return RtlLogic(parts, design, process, made.libraries)
