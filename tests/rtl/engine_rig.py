# SPDX-License-Identifier: Apache-2.0
"""The engine with a design of one region, without a board round it."""

from __future__ import annotations

import contextlib
import json
import select
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cm.rtl.compile import compile_engine, compile_units
from cm.rtl.design import RtlDesign, load_rtl_design, wiring
from cm.rtl.messages import Op
from cm.rtl.process import EngineProcess
from cm.rtl.tools import find_tools

DECOUPLE, IDENTITY = 0x4000_0100, 0x4000_010C
IN, OUT = 64 << 20, 192 << 20


class Running:
    """The engine with a static part, and a module in its region."""

    def __init__(self, design: RtlDesign, libraries: dict[str, Path], process: EngineProcess) -> None:
        self._design, self._libraries, self._process = design, libraries, process

    def write(self, address: int, value: int) -> None:
        self._process.arena[:4] = value.to_bytes(4, "little")
        assert self._process.ask(Op.WRITE, address, 1, 0, 15).a == 0

    def read(self, address: int) -> int:
        assert self._process.ask(Op.READ, address, 1, 0).a == 0
        return int.from_bytes(self._process.arena[:4], "little")

    def load(self, module: str) -> None:
        self.write(DECOUPLE, 1)
        assert self._process.ask(Op.LOAD, 0, 1, text=str(self._libraries[module])).a == 0
        self.write(DECOUPLE, 0)
        while not self.read(IDENTITY):
            pass

    def picture(self, picture: np.ndarray, room: int) -> np.ndarray:
        """What comes out when a picture goes in."""
        data = picture.tobytes()
        self._process.arena[IN : IN + len(data)] = data
        numbers = {stream.sends: number for number, stream in enumerate(self._design.streams)}
        assert self._process.ask(Op.RECEIVE, numbers[False], OUT, room).a == 0
        assert self._process.ask(Op.SEND, numbers[True], IN, len(data)).a == 0
        while True:
            for event in self._process.take():
                if event.op == Op.RECEIVED:
                    return np.frombuffer(self._process.arena[OUT : OUT + event.b], np.uint8)
            select.select([self._process], [], [], 60)


@contextlib.contextmanager
def running(schema: Path, folder: Path) -> Iterator[Running]:
    """A build schema behind the engine."""
    design, tools = load_rtl_design(schema, folder / "tree"), find_tools()
    static, *libraries = compile_units(tools, [design.static, *design.modules.values()])
    (folder / "wiring").write_text(wiring(design, static, 1))
    process = EngineProcess(compile_engine(tools), folder / "wiring")
    names = [module for _, module in design.modules]
    yield Running(design, dict(zip(names, libraries, strict=True)), process)
    cycles = json.loads(process.ask(Op.STATE).text)["cycles"]["fclk0"]
    assert cycles > 0
    process.close()
