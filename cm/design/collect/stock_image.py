# SPDX-License-Identifier: Apache-2.0
"""A design's overlays on the device tree of a board's image: what both ask for, before a board finds out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cm.design.collect.collected import compile_overlays
from cm.design.errors import BuildError, MissingTool
from cm.design.generate.outputs import render_overlays
from cm.design.plan.system import System
from cm.design.project.source_position import Finding
from cm.formats.fdt import FdtError, FdtNode, unpack
from cm.formats.tree_clashes import clashes


def check_image(system: System, image: Path) -> Iterator[Finding]:
    """A finding for each clash of the design's overlays with the tree of an image, a .dtb file."""
    files, notes = compile_overlays(render_overlays(system))
    if notes:
        raise MissingTool("--image needs dtc, which compiles the overlays (Debian: device-tree-compiler)")
    order = sorted(files, key=lambda name: not name.endswith("_static.dtbo"))  # modules' stand on its regions
    found = clashes(_tree(image), {name: unpack(files[name]) for name in order})
    return (Finding("image", ("project",), f"{image.name}: {one.text}", one.advice) for one in found)


def _tree(image: Path) -> FdtNode:
    try:
        return unpack(image.read_bytes())
    except OSError as error:
        raise BuildError(f"{image}: {error.strerror}") from error
    except FdtError as error:
        raise BuildError(f"{image} is no device tree (.dtb): {error}") from error
