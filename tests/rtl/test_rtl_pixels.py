# SPDX-License-Identifier: Apache-2.0
"""The shipped camera's Verilog against the models in software: random pictures of random sizes, every byte."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from build_support import copy_examples
from conftest import needs
from headless_rig import Running, running
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.simulation.software.hardware.models import Colorise, default, edge

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(600)]
THRESHOLD, PALETTE = 0x4001_0018, 0x4001_001C
MODELS: dict[str, Callable[..., np.ndarray]] = {"default": default, "edge": edge, "colorise": Colorise()}


@pytest.fixture(scope="module", params=[3, 17, 64])
def camera(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Running, int]]:
    """With lines of so many pixels."""
    folder = tmp_path_factory.mktemp("camera")
    with running(changed(folder, "camera", "camera_edge", f"LINE: {request.param}"), folder) as camera:
        yield camera, request.param


def changed(folder: Path, example: str, top: str, parameters: str) -> Path:
    """An example whose module has other parameters."""
    schema = copy_examples(folder) / example / "build.yaml"
    other = f"    top: {top}\n    parameters: {{{parameters}}}\n"
    schema.write_text(schema.read_text().replace(f"    top: {top}\n", other))
    return schema


@pytest.mark.parametrize(("lanes", "width"), [(4, 8), (4, 64), (2, 6), (8, 24)])
def test_more_pixels_a_clock_give_the_same_edges(lanes: int, width: int, tmp_path: Path) -> None:
    schema = changed(tmp_path, "wide", "edge_lanes", f"LINE: {width}, LANES: {lanes}")
    with running(schema, tmp_path) as board:
        board.load("edge")

        @settings(max_examples=25, deadline=None)
        @given(st.integers(3, 12), st.integers(0, 2**32 - 1), st.integers(0, 255))
        def holds(height: int, seed: int, threshold: int) -> None:
            random = np.random.default_rng(seed)
            picture = random.integers(0, random.integers(2, 257), (height, width), np.uint8)
            board.write(THRESHOLD, threshold)
            expected = edge(picture, {"threshold": threshold}).reshape(-1)
            assert np.array_equal(board.picture(picture, expected.size + 64), expected)

        holds()


@pytest.mark.parametrize(("module", "register"), [("default", 0), ("edge", THRESHOLD), ("colorise", PALETTE)])
def test_every_byte_is_that_of_the_software_model(camera: tuple[Running, int], module: str, register: int) -> None:
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
