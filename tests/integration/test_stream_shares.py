# SPDX-License-Identifier: Apache-2.0
"""A reader that asks for every slot locks out neither another process nor subscribers over ZeroMQ."""

from __future__ import annotations

import pytest
from manager_process import Manager

import cm
from cm.client.errors import RequestBusy


def test_a_reader_of_255_slots_leaves_frames_to_others(manager: Manager, board: cm.Board) -> None:
    with manager.connected() as other, board.stream("camera", depth=255, timeout=60) as greedy:
        greedy.read(timeout=60)
        (client,) = [c for s in board.status.streams for c in s.clients if s.name == "camera" and c.depth > 4]
        assert client.depth == 64
        mine = other.stream("camera", depth=4, timeout=60)  # of the same process
        with pytest.raises(RequestBusy, match=r"pid \d+ \(.*\) holds 64, of 256"):
            mine.read(timeout=60)
        assert other.read("camera", timeout=60).sequence >= 0  # over ZeroMQ
