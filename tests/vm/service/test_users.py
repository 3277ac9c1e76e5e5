# SPDX-License-Identifier: Apache-2.0
"""Who may use the service, on the board and from another machine."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from board import Board

from cm.errors import CmError


def test_a_member_of_the_group_loads_the_camera_and_sees_a_frame(board: Board) -> None:
    board.do("cm load camera", "alice")
    assert board.status("alice")["mode"] == "default"
    board.do("cm stream set camera --enable && cm stream capture camera frame.npy --count 1", "alice")
    shape = "python3 -c 'import numpy; print(numpy.load(\"frame.npy\").shape)'"
    assert board.do(shape, "alice").strip() in {"(48, 64)", "(1, 48, 64)"}


def test_one_who_is_not_in_the_group_is_told_so(board: Board) -> None:
    refused = board.run("cm status", "bob")
    assert refused.status == 1
    assert "group fpga" in refused.err
    assert "Traceback" not in refused.err


def test_a_client_with_keys_gets_frames_over_tcp(board: Board, laptop: Path) -> None:
    with board.connected(laptop) as connected:
        connected.load("camera", "edge_detection")
        with connected.stream("camera", timeout=board.patience) as stream:
            connected.configure_stream("camera", enable=True)
            frames = list(islice(stream, 3))
    words = [np.ascontiguousarray(frame).view("<u4").ravel() for frame in frames]
    assert all(np.array_equal(each, each[0] + np.arange(len(each), dtype=np.uint32)) for each in words)


def test_a_client_without_keys_is_refused(board: Board, laptop: Path) -> None:
    with pytest.raises(CmError), board.connected(None) as connected:
        _ = connected.configs


def test_a_new_key_counts_after_a_reload(board: Board, laptop: Path) -> None:
    before = board.unit("MainPID")
    board.do("sudo -u cm cm keygen /etc/cm/keys tablet", "alice")
    tablet = board.keys("tablet")
    with pytest.raises(CmError), board.connected(tablet) as connected:
        _ = connected.configs
    board.do("sudo systemctl reload cm", "alice")
    with board.connected(tablet) as connected:
        assert "camera" in connected.configs
    assert board.unit("MainPID") == before
