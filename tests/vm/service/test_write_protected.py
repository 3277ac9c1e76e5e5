# SPDX-License-Identifier: Apache-2.0
"""A root file system that is never written to; state on a tmpfs."""

from __future__ import annotations

from pathlib import Path

from beside import Twins


def test_the_service_runs_on_a_read_only_root_with_its_state_in_memory(twins: Twins, laptop: Path) -> None:
    board = twins.write_protected.result()
    assert "ro" in board.do("findmnt -no OPTIONS /").strip().split(",")
    assert board.do("findmnt -no FSTYPE /var").strip() == "tmpfs"
    with board.connected(laptop) as connected:
        connected.load("camera", "default")
        with connected.stream("camera", timeout=board.patience) as stream:
            connected.configure_stream("camera", enable=True)
            assert stream.read().shape == (48, 64)
    assert board.unit("User") == "cm"
