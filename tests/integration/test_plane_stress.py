# SPDX-License-Identifier: Apache-2.0
"""Eight readers killed at random for some seconds; `make soak` does it for a minute, from any seed."""

from __future__ import annotations

import pytest
from manager_process import Manager
from plane_readers import FRAMES, KILLS
from plane_stress import HUNG, stress

from cm.simulation.software import Board as SimBoard

pytestmark = pytest.mark.soak


def test_killed_readers_stall_nobody_leave_nothing_and_see_no_torn_frame(shared: tuple[Manager, SimBoard]) -> None:
    outcome = stress(*shared, seconds=4.0, seed=1)
    assert outcome.longest_gap < HUNG
    assert outcome.kills > KILLS
    assert outcome.frames > FRAMES
