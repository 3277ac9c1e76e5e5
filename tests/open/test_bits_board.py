# SPDX-License-Identifier: Apache-2.0
"""Modules of the open flow behind the manager and in the demonstration: they run by what was loaded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cm.client.board import Board, connect
from cm.simulation.software.hardware.camera import shipped_photos
from cm.simulation.software.hardware.models import Colorise, edge
from cm.tools.demo.scrub import run_scrub_demo
from cm.tools.testing.served import Served

pytestmark = pytest.mark.timeout(900)
DEFAULT, COLOUR = 0x44454641, 0x434F4C4F  # what the modules' Verilog says of itself


@pytest.fixture(scope="module")
def board(open_project: Path) -> Iterator[Board]:
    served = Served("bits", build=str(open_project / "build.yaml"))
    try:
        with connect(str(served.runtime), timeout=60) as connected:
            yield connected
    finally:
        served.stop()


def test_registers_and_changes_of_mode_are_those_of_the_loaded_bits(board: Board) -> None:
    board.load("open_camera", "default", progress=False)
    assert board.registers.ident == DEFAULT
    board.registers["focus"] = 7
    assert board.registers.focus == 7
    board.load("open_camera", "colorise", progress=False)
    assert board.registers.ident == COLOUR
    board.registers["palette"] = 2
    assert board.registers.palette == 2
    board.load("open_camera", "default", progress=False)
    assert board.registers.ident == DEFAULT


def test_pictures_stream_from_memory_through_the_bits_and_back_as_any_client_does_it(board: Board) -> None:
    """Also after others: a module that was just loaded gets its first byte, and keeps none of the one before it."""
    photos = list(shipped_photos().values())
    models = {
        "default": lambda photo: photo,
        "edge_detection": lambda photo: edge(photo, {"threshold": 0}),
        "colorise": lambda photo: Colorise()(photo, {"palette": 0}),
    }
    for mode in (*models, "default"):
        board.load("open_camera", mode, progress=False)
        with board.stream("camera", timeout=60) as results, board.writer("pictures", timeout=60) as writer:
            for photo in photos[:2]:
                writer.write(photo)
                assert np.array_equal(np.asarray(results.read()), models[mode](photo)), mode
        assert board.registers.frame_count == 2


def test_a_bit_that_turns_over_is_seen_in_the_picture_found_and_put_right(open_project: Path, tmp_path: Path) -> None:
    said: list[str] = []
    assert run_scrub_demo(open_project / "build.yaml", tmp_path, said.append).stat().st_size > 10_000
    assert "pixels wrong; the check found 1 bit wrong" in said[-2]
    assert ", wrong</title>" in (tmp_path / "scrub.svg").read_text("utf-8")
