# SPDX-License-Identifier: Apache-2.0
"""Where to find the files of a design that was built with open tools."""

from __future__ import annotations

from pathlib import Path

from cm.bits.errors import BitsError
from cm.bitstream import to_dma_words
from cm.build.plan.system import System
from cm.build.project.load import load_project


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
