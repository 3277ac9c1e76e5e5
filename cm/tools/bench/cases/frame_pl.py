# SPDX-License-Identifier: Apache-2.0
"""A frame through the simulated PL and back; the PL moves its bytes once each way."""

from __future__ import annotations

from contextlib import ExitStack

from cm.tools.bench.floor import Copies
from cm.tools.bench.peer import Unavailable
from cm.tools.bench.pl_loop import looped
from cm.tools.bench.result import Goal, Result, unavailable
from cm.tools.bench.rounds import Batch, Samples, interleave
from cm.tools.bench.run import IMAGE, Baselines, Run

GOALS = {
    "frame_pl_vs_zmq": Goal(7, at_least=True),
    "frame_pl_vs_zenoh": Goal(1.8, at_least=True),
    "frame_pl_vs_c": Goal(1.6),
}
RAN = (
    "round trip PS–PL–PS on the simulated board: a slot of 3.96 MiB submitted to the loop's MM2S channel, the frame "
    "from its S2MM channel received and given back"
)
BASELINES = {
    "frame_pl_vs_zmq": "pyzmq REQ/REP echo over ipc of the same bytes",
    "frame_pl_vs_zenoh": "zenoh (Python), shared buffers, the far end moves the bytes out of one and into another",
    "frame_pl_vs_c": "a C program of two processes: eventfds, and a copy out of and into shared memory",
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
    return [_result(name, found["ours"], found.get(_rival(name)), baselines.missing) for name in GOALS]


def _rival(name: str) -> str:
    return name.removeprefix("frame_pl_vs_")


def _result(name: str, ours: Samples, theirs: Samples | None, missing: dict[str, str]) -> Result:
    goal, ran = GOALS[name], f"{RAN}; baseline: {BASELINES[name]}"
    if theirs is None:
        return unavailable(name, "µs", ran, missing[_rival(name)], goal)
    ratio = theirs.over(ours) if goal.at_least else ours.over(theirs)
    details = {"samples": {"ours": ours.plain(), "baseline": theirs.plain()}}
    return Result(name, ours.median, "µs", ran, theirs.median, ratio, goal, details=details)
