# SPDX-License-Identifier: Apache-2.0
"""What a change of mode does to pictures, to streams of other regions, and to who waits or listens meanwhile."""

from __future__ import annotations

import gc
import warnings
from pathlib import Path

import numpy as np
from manager_process import Manager, patient, served, stalled, until
from reference import sobel

import cm
from cm.simulation.software.hardware.camera import shipped_photos


def test_a_frame_is_what_its_mode_makes_of_the_photograph(board: cm.Board) -> None:
    for mode, make in (("default", np.asarray), ("edge_detection", sobel)):
        board.mode = mode
        frame = board.read("camera", timeout=60)
        assert any(np.array_equal(frame, make(photo)) for photo in shipped_photos().values()), mode


def test_a_stream_of_another_region_runs_while_one_is_reconfigured(tmp_path: Path) -> None:
    with served(schemas=patient(tmp_path)) as (manager, sim), manager.connected() as board:
        board.load("camera", "default")
        board.load(mode="loopback")
        board.configure_stream("from_pl", enable=True)
        with stalled(sim):
            change = board.load_async(mode="edge_detection")
            until(lambda: any(r.state == "loading" for r in board.status.regions))
            for _ in range(5):
                board.write("to_pl", np.zeros((480, 640), np.uint8))
            assert any(r.state == "loading" for r in board.status.regions)
        change.wait(60)
        assert board.mode == "edge_detection"


def test_a_change_that_is_not_waited_for_leaves_no_socket(board: cm.Board) -> None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        board.load_async(mode="edge_detection")
        until(lambda: board.mode == "edge_detection")
        gc.collect()
        assert [str(warning.message) for warning in warned] == []


def test_interrupts_reach_every_client_while_another_holds_the_board(board: cm.Board, manager: Manager) -> None:
    board.configure_stream("camera", enable=True)
    with manager.connected() as other, other.lease("board"):
        for client in (board, other):
            events = client.interrupts["frame_done"].events(timeout=60)
            counts = [next(events).count for _ in range(5)]
            assert counts == sorted(set(counts))
