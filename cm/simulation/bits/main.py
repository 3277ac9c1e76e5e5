# SPDX-License-Identifier: Apache-2.0
"""The process of a simulated board whose regions behave as the bits of their bitstreams say."""

from __future__ import annotations

import argparse
import logging
import shutil
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from cm.design.plan.system import System
from cm.design.project.load import load_project
from cm.formats.bitstream import to_dma_words
from cm.simulation.bits.regions import BitsError, LoadedBits
from cm.simulation.rtl.compile import Watched
from cm.simulation.rtl.design import RtlDesign
from cm.simulation.rtl.main import Made, add_rtl_arguments
from cm.simulation.rtl.main import run as run_rtl
from cm.simulation.rtl.tools import Tools
from cm.simulation.software.hardware.logic import LogicParts
from cm.simulation.software.transport.scratch import Scratch, temporary


def collected(build: Path) -> Path:
    """The folder that `cm build collect` has made of a build schema. Raises BitsError if there is none."""
    project = load_project(build)
    found = project.folder / "target" / project.name
    if not (found / f"{project.name}.yaml").is_file():
        raise BitsError(
            f"{found} is not there: `cm build run --flow open {build}` and `cm build collect --schema {build}` make it"
        )
    return found


def streams_of(files: Path, system: System) -> tuple[list[bytes], dict[str, bytes]]:
    """The full bitstreams in a folder, and the partial ones by module, in the order of DMA memory."""
    modules = {one.name for one in system.implementations}
    found = {path.stem: to_dma_words(path) for path in sorted(files.glob("*.bin"))}
    whole = [stream for name, stream in found.items() if name not in modules]
    return whole, {name: stream for name, stream in found.items() if name in modules}


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m cm.simulation.bits``; the exit status."""
    parser = argparse.ArgumentParser(
        "python -m cm.simulation.bits", description="a simulated board whose regions run their bits"
    )
    add_rtl_arguments(parser)
    logging.basicConfig(level=logging.WARNING, format="cm sim: %(message)s")
    args = parser.parse_args(argv)
    with Scratch("cm-bits-", temporary()) as folder:
        return run_rtl(args, partial(_libraries, args, folder))


def _libraries(
    args: argparse.Namespace, folder: Path, tools: Tools, design: RtlDesign, watched: Watched, parts: LogicParts
) -> Made:
    files = collected(args.build)
    loaded = LoadedBits.of(design.system, tools, watched, folder)
    whole, modules = streams_of(files, design.system)
    loaded.prepare(whole, modules.values())
    _install(files, Path(args.root) / "lib/firmware/cm" / design.system.project.name)
    parts.fabric.configured = loaded.take
    return Made(loaded, {})


def _install(files: Path, firmware: Path) -> None:
    """Put bitstreams where the manager looks for them; existing files are kept."""
    firmware.mkdir(parents=True, exist_ok=True)
    for path in files.iterdir():
        if path.is_file() and not (firmware / path.name).exists():
            shutil.copyfile(path, firmware / path.name)
