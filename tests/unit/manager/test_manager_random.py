# SPDX-License-Identifier: Apache-2.0
"""Any change after any other: operations fail once or for good, the manager is restarted, or dies in between.

`CM_RANDOM_CHANGES` makes the run longer, `CM_RANDOM_SEED` gives another one.
"""

from __future__ import annotations

import os
import random
from collections import Counter
from pathlib import Path

import pytest
from manager_support import Rig, killed_at, place_of, rig

from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard

CHANGES = int(os.environ.get("CM_RANDOM_CHANGES", "60"))
SEED = int(os.environ.get("CM_RANDOM_SEED", "1"))


def go(made: Rig, place: str) -> str:
    """The code of the error; empty if there was none."""
    config, _, mode = place.partition("/")
    error = made.go(mode, config=config)
    return error.code if error else ""


@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_the_board_is_where_the_manager_says_it_is(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, seed: int
) -> None:
    chance = random.Random(seed)
    places = [f"{config.name}/{mode}" for config in configs.values() for mode in config.modes]
    ends: Counter[str] = Counter()
    before = ""
    for _ in range(CHANGES // 10):
        if chance.random() < 0.7:
            config, _, mode = chance.choice([*places, "duo/-prr1"]).partition("/")
            killed_at(sim.root, tmp_path, configs.values(), (config, mode), chance.randrange(60))
        with rig(sim.root, tmp_path, *configs.values()) as made:
            made.manager.wait_idle()
            before = place_of(made, sim, configs)
            for _ in range(10):
                loaded = made.manager.state.config
                goal = chance.choice([*places, *([f"{loaded}/-*"] * 3 if loaded else ())])
                if chance.random() < 0.6:
                    made.arm(chance.randrange(60), times=chance.choice([1, 1, 1, 2, 5, 10_000]))
                code = go(made, goal)
                said = f"seed {seed}: from {before} to {goal}, {made.fault.at, made.fault.times}: {code}"
                made.arm(-1)
                end, in_mode = place_of(made, sim, configs), before and "/-" not in before
                assert code or end in (goal, goal.replace("ported/-*", "")), said
                assert code in ("", "undo_failed") or not in_mode or end == before, said
                before = end
                ends[code] += 1
    assert ends[""] > CHANGES // 3
    assert {"device_error", "undo_failed"} <= ends.keys()
