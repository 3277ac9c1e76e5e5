# SPDX-License-Identifier: Apache-2.0
"""The engine with a design of one region, without a board round it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cm.simulation.rtl.compile import compile_units
from cm.simulation.rtl.design import load_rtl_design
from cm.simulation.rtl.headless import HeadlessDesign
from cm.simulation.rtl.tools import find_tools


class Running:
    """The engine with a static part, and a module in its region."""

    def __init__(self, design: HeadlessDesign, libraries: dict[str, Path]) -> None:
        self._design, self._libraries = design, libraries
        self.write = design.write

    def load(self, module: str) -> None:
        assert self._design.load(self._libraries[module])

    def picture(self, picture: np.ndarray, room: int) -> np.ndarray:
        """What comes out when a picture goes in."""
        return self._design.through(picture.tobytes(), room)


@contextlib.contextmanager
def running(schema: Path, folder: Path) -> Iterator[Running]:
    """A build schema in the harness."""
    design, tools = load_rtl_design(schema, folder / "tree"), find_tools()
    static, *libraries = compile_units(tools, [design.static, *design.modules.values()])
    names = [module for _, module in design.modules]
    with HeadlessDesign(tools, design, static, folder) as bare:
        yield Running(bare, dict(zip(names, libraries, strict=True)))
        assert bare.cycles["fclk0"] > 0
