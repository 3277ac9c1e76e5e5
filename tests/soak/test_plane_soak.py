# SPDX-License-Identifier: Apache-2.0
"""Eight readers killed at random for a minute."""

from __future__ import annotations

import secrets

import pytest
from manager_process import served
from plane_stress import stress


@pytest.mark.timeout(300)
def test_a_minute_of_killed_readers() -> None:
    seed = secrets.randbelow(1 << 20)
    with served() as (manager, sim):
        outcome = stress(manager, sim, seconds=60.0, seed=seed)
    print(f"seed {seed}: {outcome}")
    assert outcome.longest_gap < 5.0
    assert outcome.frames > 1000
