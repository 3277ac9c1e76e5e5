# SPDX-License-Identifier: Apache-2.0
"""A later package takes the place of the one that runs."""

from __future__ import annotations

from pathlib import Path

from board import Board


def test_an_upgrade_loads_nothing_and_the_frames_come_back(board: Board, laptop: Path) -> None:
    with board.connected(laptop) as connected:
        connected.load("camera", "edge_detection")
        connected.registers["threshold"] = 9
        with connected.stream("camera", timeout=board.patience) as stream:
            connected.configure_stream("camera", enable=True)
            stream.read()
            loads, pid = board.loads, board.unit("MainPID")
            board.do("dpkg --install /opt/cm/later/fpga-cm_*.deb")
            board.until(lambda: board.unit("ActiveState") == "active" and board.unit("MainPID") != pid)
            version = board.do("dpkg-query -W -f '${Version}' fpga-cm")
            assert version.endswith("+later")
            assert (connected.mode, board.loads) == ("edge_detection", loads)
            after = stream.read()
        assert after.info.mode == "edge_detection"
        assert connected.registers["threshold"] == 9
