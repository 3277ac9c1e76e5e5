# SPDX-License-Identifier: Apache-2.0
"""The service in systemd's hands."""

from __future__ import annotations

from pathlib import Path

from beside import Twins
from board import Board


def test_a_manager_that_hangs_is_restarted_and_finds_what_runs(board: Board, laptop: Path, twins: Twins) -> None:
    with board.connected(laptop) as connected:
        connected.load("camera", "colorise")
    loads, restarts = board.loads, int(board.unit("NRestarts"))
    board.do(f"kill -STOP {board.unit('MainPID')}")
    board.until(lambda: int(board.unit("NRestarts")) == restarts + 1 and board.unit("ActiveState") == "active")
    assert "watchdog timeout" in board.do("journalctl -u cm -b --no-pager").lower()
    with board.connected(laptop) as connected:
        assert (connected.mode, board.loads) == ("colorise", loads)


def test_without_systemd_the_script_starts_reloads_and_stops_it(board: Board) -> None:
    script = "sh /opt/cm/sysv"
    board.do("systemctl stop cm")
    try:
        assert board.run(f"{script} status").status == 3
        board.do(f"{script} start")
        board.until(lambda: board.run("cm configs", "alice").status == 0)
        assert "is running" in board.do(f"{script} status")
        rights = board.do("id -u cm; grep -E '^(Uid|CapEff)' /proc/$(cat /run/cm.pid)/status").split()
        assert rights[1:] == ["Uid:", *rights[:1] * 4, "CapEff:", "0000000000000002"]
        board.do(f"{script} reload")
        assert "camera" in board.do("cm configs", "alice")
        board.do(f"{script} stop")
        assert board.run(f"{script} status").status == 3
    finally:
        board.do("systemctl --no-block start cm")
