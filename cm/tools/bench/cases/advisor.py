# SPDX-License-Identifier: Apache-2.0
"""How long the partitioning advisor takes for thirty modules, twenty modes and four slots."""

from __future__ import annotations

import random
import statistics
import time

from cm.design.errors import MissingTool
from cm.design.partition.advisor import advise
from cm.design.partition.model import Partition, Problem, Unit, UsedMode
from cm.design.partition.utilisation import part_of
from cm.design.project.model import Resources
from cm.tools.bench.result import Goal, Result, unavailable
from cm.tools.bench.run import Run

NAME = "advisor"
RAN = (
    "cm build partition's search: 30 modules, 20 modes of 4 modules each, worst time of a change, half of an xc7z020; "
    "median over ten such problems, and the slowest in the details"
)
GOAL = Goal(10.0, at_least=False)
LIMIT = 60.0


def run(bench: Run) -> list[Result]:
    """Measure `advisor`."""
    times, gaps = [], []
    for seed in range(2 if bench.quick else 10):
        problem = _problem(seed)
        begun = time.perf_counter()
        try:
            found: Partition = advise(problem, "worst", LIMIT)
        except MissingTool as why:
            return [unavailable(NAME, "s", RAN, str(why), GOAL)]
        times.append(time.perf_counter() - begun)
        gaps.append(found.gap("worst"))
    details = {"slowest": max(times), "largest_gap": max(gaps), "problems": len(times)}
    return [Result(NAME, statistics.median(times), "s", RAN, goal=GOAL, details=details)]


def _problem(seed: int) -> Problem:
    draw = random.Random(seed)
    units = {
        f"m{i}": Unit(f"m{i}", Resources(draw.randint(300, 4000), draw.randint(300, 6000), 0, draw.randint(0, 20)))
        for i in range(30)
    }
    slots = [[f"m{i}" for i in range(30) if i % 4 == slot] for slot in range(4)]
    modes = [UsedMode(f"mode{i}", frozenset(draw.choice(names) for names in slots)) for i in range(20)]
    return Problem(part_of("xc7z020"), units, modes, 4e8, budget=0.5)
