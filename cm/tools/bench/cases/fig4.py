# SPDX-License-Identifier: Apache-2.0
"""The paper's Fig. 4: round trips PS–PL–PS of images, on the simulated board."""

from __future__ import annotations

from contextlib import ExitStack

from cm.tools.bench.c_programs import Copies
from cm.tools.bench.peer import Unavailable
from cm.tools.bench.pl_loop import looped
from cm.tools.bench.result import Result
from cm.tools.bench.rounds import Batch, Plan, interleave
from cm.tools.bench.run import IMAGE, IMAGES, Baselines, Run

TRIPS = 1000
NAMES = {"ours": "through the simulated PL", "zmq": "pyzmq ipc echo", "c": "C, two copies"}
RAN = "1000 round trips PS–PL–PS of images of 7.91, 3.96 and 1.98 MiB on the simulated board, in 20 rounds"


def run(bench: Run) -> list[Result]:
    """Measure `fig4`."""
    plan = Plan(1, 4, 1) if bench.quick else Plan(20, TRIPS // 20, 2)
    series: dict[str, list[dict[str, float]]] = {}
    missing: dict[str, str] = {}
    for size in IMAGES:
        with ExitStack() as stack:
            baselines = Baselines(bench, stack)
            baselines.add(["zmq"], size)
            contestants: dict[str, Batch] = {"ours": stack.enter_context(looped(bench, size)), **baselines.batches}
            try:
                contestants["c"] = stack.enter_context(Copies(bench.place("c"), size)).batch
            except Unavailable as why:
                missing["c"] = str(why)
            found = interleave(contestants, plan)
        for name, samples in found.items():
            series.setdefault(NAMES[name], []).append({"bytes": size, **samples.plain()})
    value = next(point["median"] for point in series[NAMES["ours"]] if point["bytes"] == IMAGE)
    return [Result("fig4", value, "µs", RAN, details={"series": series, "not_available": missing})]
