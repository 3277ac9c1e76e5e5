# SPDX-License-Identifier: Apache-2.0
"""The power goes at any time: what was told as done is there, and the record of the old boot counts no more."""

from __future__ import annotations

from pathlib import Path

from beside import Twins


def test_imports_and_keys_outlast_a_power_cut_and_what_was_loaded_does_not(twins: Twins, laptop: Path) -> None:
    board = twins.restarted.result()
    with board.connected(laptop) as connected:
        assert not connected.status.config_name
        assert {"camera", "second"} <= set(connected.configs)
        connected.load("second", "default")
        assert connected.mode == "default"
    assert "installed" in board.do("dkms status fpga-cm")
