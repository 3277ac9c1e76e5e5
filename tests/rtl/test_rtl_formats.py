# SPDX-License-Identifier: Apache-2.0
"""Pictures in beats of 8 to 64 bits and their colours, through modules behind DMA and VDMA."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from conftest import HERE, needs, served

import cm

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(600)]
FORMATS = HERE / "formats/build.yaml"


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    folder = tmp_path_factory.mktemp("run")
    with served(folder, FORMATS, "formats", "--sim-icap-rate", "0", mode="all", timeout=120) as connected:
        yield connected


def through(board: cm.Board, bits: int, picture: np.ndarray) -> np.ndarray:
    with board.stream(f"from_{bits}", timeout=60) as back, board.writer(f"to_{bits}", timeout=60) as out:
        out.write(picture)
        return np.array(back.read())


def rgb(*shape: int) -> np.ndarray:
    return np.random.default_rng(7).integers(0, 256, (*shape, 3), np.uint8)


def without_red(picture: np.ndarray) -> np.ndarray:
    return picture ^ np.array([0xFF, 0, 0], np.uint8)


def test_numbers_of_any_width_keep_their_order_and_the_last_beat_its_length(board: cm.Board) -> None:
    grey = rgb(5, 7)[..., 0]
    assert np.array_equal(through(board, 8, grey), ~grey)
    wide = np.arange(35, dtype=np.uint16).reshape(5, 7) * 1000
    assert np.array_equal(through(board, 64, wide), ~wide)


def test_a_frame_of_a_module_without_tlast_ends_where_it_is_full(board: cm.Board) -> None:
    samples = np.arange(32, dtype=np.uint16)
    with board.stream("from_12", timeout=60) as back, board.writer("to_12", timeout=60) as out:
        for begin in (0, 1000):
            out.write(samples + begin)
            assert back.read().tolist() == [*range(begin, begin + 32, 4)]


def test_red_is_where_xilinx_cores_have_it_and_a_frame_has_its_start_and_lines(board: cm.Board) -> None:
    """Through VDMA: TUSER with the first beat, TLAST with the last of each line; the module turns bits 16 to 23."""
    picture = rgb(6, 8)
    assert np.array_equal(through(board, 24, picture), without_red(picture))


def test_two_pixels_to_a_beat_and_pixels_across_beats_keep_their_colours(board: cm.Board) -> None:
    picture = rgb(5, 7)
    assert np.array_equal(through(board, 32, picture), picture)
    assert np.array_equal(through(board, 48, picture), without_red(picture))


def test_yuv_comes_as_rgb_and_goes_as_it_came(board: cm.Board) -> None:
    picture = np.full((6, 8, 3), (200, 60, 20), np.uint8)
    picture[:, 4:] = (10, 90, 180)
    assert np.abs(through(board, 16, picture).astype(int) - picture).max() <= 3
    with board.stream("from_16", timeout=60, raw=True) as back:
        board.write("to_16", picture)
        assert back.read().shape == (6, 8, 2)
