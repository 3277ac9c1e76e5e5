# SPDX-License-Identifier: Apache-2.0
"""The shipped camera's Verilog against the models in software: random pictures of random sizes, every byte."""

from __future__ import annotations

import json
import select
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from build_support import copy_examples
from conftest import needs
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.rtl.compile import compile_engine, compile_units
from cm.rtl.design import RtlDesign, load_rtl_design, wiring
from cm.rtl.messages import Op
from cm.rtl.process import EngineProcess
from cm.rtl.tools import find_tools
from cm.sim.hardware.models import Colorise, default, edge

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(600)]
DECOUPLE, IDENTITY, THRESHOLD, PALETTE = 0x4000_0100, 0x4000_010C, 0x4001_0018, 0x4001_001C
IN, OUT = 64 << 20, 192 << 20
MODELS: dict[str, Callable[..., np.ndarray]] = {"default": default, "edge": edge, "colorise": Colorise()}


class Camera:
    """The engine with the camera's static part, and a module of it in the region."""

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


@pytest.fixture(scope="module", params=[3, 17, 64])
def camera(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Camera, int]]:
    """With lines of so many pixels."""
    folder = tmp_path_factory.mktemp("camera")
    schema = copy_examples(folder) / "camera/build.yaml"
    text = schema.read_text()
    parameters = f"    top: camera_edge\n    parameters: {{LINE: {request.param}}}\n"
    schema.write_text(text.replace("    top: camera_edge\n", parameters))
    design, tools = load_rtl_design(schema, folder / "tree"), find_tools()
    static, *libraries = compile_units(tools, [design.static, *design.modules.values()])
    (folder / "wiring").write_text(wiring(design, static, 1))
    process = EngineProcess(compile_engine(tools), folder / "wiring")
    names = [module for _, module in design.modules]
    yield Camera(design, dict(zip(names, libraries, strict=True)), process), request.param
    cycles = json.loads(process.ask(Op.STATE).text)["cycles"]["fclk0"]
    assert cycles > 0
    process.close()


@pytest.mark.parametrize(("module", "register"), [("default", 0), ("edge", THRESHOLD), ("colorise", PALETTE)])
def test_every_byte_is_that_of_the_software_model(camera: tuple[Camera, int], module: str, register: int) -> None:
    board, width = camera
    board.load(module)

    @settings(max_examples=25)
    @given(st.integers(3, 12), st.integers(0, 2**32 - 1), st.integers(0, 255))
    def holds(height: int, seed: int, value: int) -> None:
        random = np.random.default_rng(seed)
        picture = random.integers(0, random.integers(2, 257), (height, width), np.uint8)
        value = value % 4 if module == "colorise" else value
        if register:
            board.write(register, value)
        expected = MODELS[module](picture, {"threshold": value, "palette": value}).reshape(-1)
        assert np.array_equal(board.picture(picture, expected.size + 64), expected)

    holds()
