# SPDX-License-Identifier: Apache-2.0
"""Thousands of changes of mode leave nothing behind."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import pytest
from manager_process import until
from manager_support import Rig, rig

from cm.simulation.software import Board as SimBoard

MODES = ("edge_detection", "colorise", "loopback", "loopback_edge", "default")
WARM_UP = 50
RSS_GROWTH = 1.02
PAGE = os.sysconf("SC_PAGESIZE")


@pytest.fixture
def made(tmp_path: Path) -> Iterator[tuple[Rig, SimBoard]]:
    with SimBoard(arguments=["--icap-rate", "0"]) as sim, rig(sim.root, tmp_path) as started:
        yield started, sim


def held(sim: SimBoard) -> dict[str, Any]:
    """What this process and the board hold on to."""
    state = sim.control.state()
    return {
        "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        "buffers": state["buffers"],
        "connections": state["connections"],
        "overlays": sorted(state["overlays"]),
    }


def resident() -> int:
    """Pages in memory."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])


@pytest.mark.timeout(3600)
def test_many_changes_of_mode_leave_nothing_behind(made: tuple[Rig, SimBoard], changes: int) -> None:
    board, sim = made
    before: dict[str, Any] = {}
    pages, started = 0, 0.0
    for number, mode in enumerate(islice(cycle(MODES), WARM_UP + changes)):
        assert board.go(mode) is None
        board.fault.names.clear()  # the test's own record
        board.data_plane.calls.clear()
        if number == WARM_UP - 1:
            before, pages, started = held(sim), resident(), time.monotonic()
    took = time.monotonic() - started
    print(f"{changes} changes in {took:.1f} s; {held(sim)}; RSS {pages * PAGE >> 10} → {resident() * PAGE >> 10} KiB")
    until(lambda: all(now <= before[what] for what, now in held(sim).items()))  # the board ends connections later
    assert resident() <= pages * RSS_GROWTH
    journal = board.journal._path.stat().st_size
    assert journal < 1 << 20
