# SPDX-License-Identifier: Apache-2.0
"""The power goes at any time: what was told as done is there, and the record of the old boot counts no more."""

from __future__ import annotations

from pathlib import Path

from board import Board


def test_imports_and_keys_outlast_a_power_cut_and_what_was_loaded_does_not(board: Board, laptop: Path) -> None:
    board.do("cm load camera edge_detection")
    board.do("cm import archive /opt/cm/second.tar.gz")
    board.booted.cut_power()
    board.start()
    board.until(lambda: board.unit("ActiveState") == "active")
    status = board.status()
    assert not status.get("config_name")
    with board.connected(laptop) as connected:
        assert {"camera", "second"} <= set(connected.configs)
        connected.load("second", "default")
        assert connected.mode == "default"
    assert "installed" in board.do("dkms status fpga-cm")
