# SPDX-License-Identifier: Apache-2.0
"""Eight readers killed at random, from another seed each time; `make soak` does it for a minute."""

from __future__ import annotations

import secrets

import pytest
from manager_process import served
from plane_readers import FRAMES, KILLS
from plane_stress import HUNG, stress


@pytest.mark.timeout(300)
def test_readers_are_killed_for_long(stress_seconds: float) -> None:
    seed = secrets.randbelow(1 << 20)
    with served() as (manager, sim):
        outcome = stress(manager, sim, seconds=stress_seconds, seed=seed)
    print(f"seed {seed}: {outcome}")
    assert outcome.longest_gap < HUNG
    assert outcome.kills > KILLS
    assert outcome.frames > FRAMES
