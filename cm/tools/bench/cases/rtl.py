# SPDX-License-Identifier: Apache-2.0
"""How fast the simulated RTL is: pictures through edge modules of one and four bytes per beat, and registers."""

from __future__ import annotations

import contextlib
import statistics
from pathlib import Path

from cm.simulation.rtl.compile import compile_units
from cm.simulation.rtl.design import load_rtl_design
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.headless import HeadlessDesign
from cm.simulation.rtl.main import example_build
from cm.simulation.rtl.tools import Tools, find_tools
from cm.simulation.software.hardware.camera import shipped_photos
from cm.tools.bench.result import Goal, Result, unavailable
from cm.tools.bench.run import Run

SHAPE = (480, 640)
FRAMES = (
    "pictures of 640 × 480 through the static part and the edge module of the shipped camera, a byte a beat, "
    "for each second of processor time of the engine"
)
WIDE = (
    "pictures of 640 × 480 from memory through the static part and the edge module of the example `wide`, four bytes a "
    "beat, for each second of processor time of the engine"
)
WIDE_GOAL = Goal(120, at_least=True)
REGISTERS = "reads of a module's registers over AXI4-Lite for each second of processor time of the engine"
REGISTERS_GOAL = Goal(100_000, at_least=True)
_WORDS, _REGISTERS = 4096, 0x4001_0000


def run(bench: Run) -> list[Result]:
    """Measure `rtl_frames`, `rtl_frames_wide` and `rtl_registers`."""
    rounds = 1 if bench.quick else 20
    try:
        tools = find_tools()
        with contextlib.ExitStack() as stack:
            camera = stack.enter_context(_Engine(tools, bench.place("rtl"), "camera"))
            wide = stack.enter_context(_Engine(tools, bench.place("rtl-wide"), "wide"))
            times = [(camera.frame(), wide.frame(), camera.reads() / _WORDS) for _ in range(rounds)]
    except RtlError as why:
        missing = str(why)
        return [
            unavailable("rtl_frames", "frames/s", FRAMES, missing),
            unavailable("rtl_frames_wide", "frames/s", WIDE, missing, WIDE_GOAL),
            unavailable("rtl_registers", "reads/s", REGISTERS, missing, REGISTERS_GOAL),
        ]
    frame, wide_frame, read = (1 / statistics.median(of_one) for of_one in zip(*times, strict=True))
    pixels = SHAPE[0] * SHAPE[1]
    about = [{"clocks_of_a_frame": count, "verilator": tools.version} for count in (pixels, pixels // 4)]
    return [
        Result("rtl_frames", frame, "frames/s", FRAMES, details=about[0]),
        Result("rtl_frames_wide", wide_frame, "frames/s", WIDE, details=about[1], goal=WIDE_GOAL),
        Result("rtl_registers", read, "reads/s", REGISTERS, goal=REGISTERS_GOAL),
    ]


class _Engine:
    """An example with its edge module, without a board round it."""

    def __init__(self, tools: Tools, folder: Path, example: str) -> None:
        schema = example_build().parents[1] / example / "build.yaml"
        design = load_rtl_design(schema, folder / "tree")
        static, edge = compile_units(tools, [design.static, design.modules["prr0", "edge"]])
        self._design = HeadlessDesign(tools, design, static, folder)
        self._design.load(edge)
        self._picture = next(iter(shipped_photos().values())).tobytes()  # noise would cost a third more: branches

    def frame(self) -> float:
        """Processor time for a picture, in seconds."""
        before = self._design.cpu_seconds
        self._design.through(self._picture, len(self._picture))
        return self._design.cpu_seconds - before

    def reads(self) -> float:
        """Processor time for many reads, in seconds."""
        before = self._design.cpu_seconds
        self._design.read(_REGISTERS, _WORDS)
        return self._design.cpu_seconds - before

    def __enter__(self) -> _Engine:
        return self

    def __exit__(self, *_: object) -> None:
        self._design.__exit__()
