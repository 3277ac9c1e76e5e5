# SPDX-License-Identifier: Apache-2.0
"""A frame to the manager and back, by descriptor."""

from __future__ import annotations

from contextlib import ExitStack

from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import beside, interleave, timed
from cm.tools.bench.run import IMAGE, Baselines, Run
from cm.tools.bench.serving import PATIENCE, serve

GOALS = {
    "frame_local_vs_zmq": Goal(100, at_least=True),
    "frame_local_vs_64b": Goal(1.25),
    "frame_local_vs_iceoryx2": Goal(1.0),
}
RAN = "descriptor round trip client → manager → client (echo slots, nothing copied) with frames of 3.96 MiB"
BASELINES = {
    "frame_local_vs_zmq": "pyzmq REQ/REP echo over ipc of the same bytes",
    "frame_local_vs_64b": "the same with frames of 64 bytes",
    "frame_local_vs_iceoryx2": "iceoryx2 (Python), event there and event back",
}


def run(bench: Run) -> list[Result]:
    """Measure `frame_local_vs_*`."""
    with ExitStack() as stack:
        baselines = Baselines(bench, stack)
        baselines.add(("zmq", "iceoryx2"), IMAGE)
        board = stack.enter_context(stack.enter_context(serve(bench)).connect())
        image, small = (stack.enter_context(board.echo(size, PATIENCE)) for size in (IMAGE, 64))
        few = {"zmq": baselines.batches["zmq"]}
        many = {name: batch for name, batch in baselines.batches.items() if name != "zmq"}
        ours = {"image": timed(image.round_trip), "64b": timed(small.round_trip)}
        slow = interleave({**few, "image": ours["image"]}, bench.plan(10))
        fast = interleave({**ours, **many}, bench.plan(300))
    samples = {
        "frame_local_vs_zmq": (slow["image"], slow["zmq"]),
        "frame_local_vs_64b": (fast["image"], fast["64b"]),
        "frame_local_vs_iceoryx2": (fast["image"], fast.get("iceoryx2")),
    }
    missing = "; ".join(baselines.missing.values())
    return [
        beside(name, f"{RAN}; baseline: {BASELINES[name]}", ours, theirs, GOALS[name], missing)
        for name, (ours, theirs) in samples.items()
    ]
