# SPDX-License-Identifier: Apache-2.0
"""A frame through the simulated PL and back; the PL moves its bytes once each way."""

from __future__ import annotations

from contextlib import ExitStack

from cm.tools.bench.c_programs import Copies
from cm.tools.bench.peer import Unavailable
from cm.tools.bench.pl_loop import looped
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Batch, beside, interleave
from cm.tools.bench.run import IMAGE, Baselines, Run

GOALS = {"zmq": Goal(7, at_least=True), "zenoh": Goal(1.8, at_least=True), "c": Goal(1.6)}
RAN = (
    "round trip PS–PL–PS on the simulated board: a slot of 3.96 MiB submitted to the loop's MM2S channel, the frame "
    "from its S2MM channel received and given back"
)
BASELINES = {
    "zmq": "pyzmq REQ/REP echo over ipc of the same bytes",
    "zenoh": "zenoh (Python), shared buffers, the far end moves the bytes out of one and into another",
    "c": "a C program of two processes: eventfds, and a copy out of and into shared memory",
}


def run(bench: Run) -> list[Result]:
    """Measure `frame_pl_vs_*`."""
    with ExitStack() as stack:
        baselines = Baselines(bench, stack)
        baselines.add(("zmq", "zenoh"), IMAGE)
        contestants: dict[str, Batch] = dict(baselines.batches)
        try:
            contestants["c"] = stack.enter_context(Copies(bench.place("c"), IMAGE)).batch
        except Unavailable as why:
            baselines.missing["c"] = str(why)
        contestants["ours"] = stack.enter_context(looped(bench, IMAGE))
        found = interleave(contestants, bench.plan(20))
    return [
        beside(
            f"frame_pl_vs_{rival}", f"{RAN}; baseline: {BASELINES[rival]}", found["ours"], found.get(rival), goal,
            baselines.missing.get(rival, ""),
        )
        for rival, goal in GOALS.items()
    ]  # fmt: skip
