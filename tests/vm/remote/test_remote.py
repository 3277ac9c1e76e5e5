# SPDX-License-Identifier: Apache-2.0
"""The camera system on the virtual board, driven from another machine over TCP."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest

import cm

PATIENCE = float(os.environ["CM_TEST_PATIENCE"])  # seconds for one step


@pytest.fixture
def board() -> Iterator[cm.Board]:
    with cm.connect(os.environ["CM_VM_ENDPOINT"], timeout=PATIENCE) as connected:
        connected.load("camera", "default")
        yield connected


def test_the_board_tells_what_it_holds(board: cm.Board) -> None:
    assert (board.status.config_name, board.mode) == ("camera", "default")


def test_a_change_of_mode_tells_its_progress(board: cm.Board) -> None:
    told: list[object] = []
    board.load(mode="edge_detection", progress=told.append)
    assert board.mode == "edge_detection"
    assert told


def test_registers_are_set_by_name(board: cm.Board) -> None:
    board.registers["focus"] = 3
    assert board.registers.read("focus", "zoom") == {"focus": 3, "zoom": 1}


def test_pictures_come_over_the_network(board: cm.Board) -> None:
    with board.stream("camera", timeout=PATIENCE) as stream:
        board.configure_stream("camera", enable=True)
        frames = list(islice(stream, 3))
    assert [frame.shape for frame in frames] == [(48, 64)] * 3
    for frame in frames:
        words = np.ascontiguousarray(frame).view("<u4").ravel()
        assert np.array_equal(words, words[0] + np.arange(len(words), dtype=np.uint32))


def test_modes_change_while_pictures_flow(board: cm.Board) -> None:
    with board.stream("camera", timeout=PATIENCE) as stream:
        board.configure_stream("camera", enable=True)
        for mode in ("edge_detection", "default", "edge_detection"):
            board.mode = mode
            assert next(frame for frame in stream if frame.info.mode == mode).shape == (48, 64)


def test_data_go_through_the_loop(board: cm.Board) -> None:
    board.mode = "loopback"
    sent = np.random.default_rng(7).integers(0, 256, (48, 64), np.uint8)
    with board.stream("from_pl", timeout=PATIENCE) as stream:
        board.configure_stream("from_pl", enable=True)
        board.write("to_pl", sent)
        assert np.array_equal(stream.read(), sent)


def test_an_unknown_mode_is_refused_with_a_sentence(board: cm.Board) -> None:
    with pytest.raises(cm.CmError, match="sharpen"):
        board.mode = "sharpen"
