# SPDX-License-Identifier: Apache-2.0
"""Who may use the service, on the board and from another machine."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from beside import Beside
from board import Board

from cm.errors import CmError


def test_a_member_of_the_group_loads_the_camera_and_sees_a_frame(board: Board, beside: Beside) -> None:
    assert board.do("cm load camera", "alice").startswith("camera/default")
    read = "s = b.stream('camera', timeout=300); b.configure_stream('camera', enable=True); print(s.read().shape)"
    assert board.do(f'python3 -c "import cm; b = cm.connect(timeout=300); {read}"', "alice").strip() == "(48, 64)"


def test_a_user_outside_the_group_learns_the_reason(board: Board) -> None:
    refused = board.run("cm status", "bob")
    assert refused.status == 1
    assert "members of fpga" in refused.err
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


def test_two_members_of_the_group_have_different_roles_and_a_third_has_none(board: Board) -> None:
    access = "access: {local: [], users: {alice: operate, carol: observe}}"
    join = "for user in bob carol; do gpasswd -a $user fpga; done"
    board.do(f"{join}; echo '{access}' >>/etc/cm/cm.yaml; systemctl reload cm")
    try:
        assert "camera" in board.do("cm configs", "carol")
        refused = board.run("cm load camera colorise", "carol")
        assert (refused.status, "operate" in refused.err) == (1, True), refused.said
        nobody = board.run("cm configs", "bob")
        assert (nobody.status, "gives this user no role" in nobody.err) == (1, True), nobody.said
        board.do("cm load camera colorise", "alice")
    finally:
        leave = "for user in bob carol; do gpasswd -d $user fpga; done"
        board.do(f"{leave}; sed -i '/^access:/d' /etc/cm/cm.yaml; systemctl reload cm")
