# SPDX-License-Identifier: Apache-2.0
"""The paper's Fig. 5: latency against payload, by ipc and tcp; the alternatives; the manager."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack

from cm.tools.bench.pl_loop import echoed, looped, looped_over_tcp
from cm.tools.bench.result import Result
from cm.tools.bench.rounds import Batch, Samples, interleave
from cm.tools.bench.run import IMAGE, IMAGES, Baselines, Run

SIZES = (64, 4096, 65536, 1 << 20, *sorted(IMAGES))
KINDS = ("zmq", "zmq_tcp", "zenoh", "iceoryx2")
NAMES = {"zmq": "pyzmq ipc", "zmq_tcp": "pyzmq tcp"}
NAMES |= {"zenoh": "zenoh, shared memory", "iceoryx2": "iceoryx2, events only"}
SLOW_US = 50_000  # a peer that takes longer for a trip makes fewer
OURS: dict[str, Callable[[Run, int], AbstractContextManager[Batch]]] = {
    "fpga-cm, descriptors": echoed,
    "fpga-cm, through the simulated PL": looped,
    "fpga-cm, through the simulated PL, over tcp": looped_over_tcp,
}
RAN = (
    "round trips between two processes by payload: pyzmq REQ/REP over ipc and tcp, the baselines of the extra, "
    "descriptors to the manager and back, and PS–PL–PS on the simulated board from a local client and from one over tcp"
)


def run(bench: Run) -> list[Result]:
    """Measure `fig5`."""
    series: dict[str, list[dict[str, float]]] = {}
    missing: dict[str, str] = {}
    at_image: Samples | None = None
    for size in SIZES[:: 3 if bench.quick else 1]:
        with ExitStack() as stack:
            baselines = Baselines(bench, stack)
            baselines.add(KINDS, size)
            missing.update(baselines.missing)
            ours = {name: stack.enter_context(make(bench, size)) for name, make in OURS.items()}
            found = _timed(bench, size, {**baselines.batches, **ours})
        for name, samples in found.items():
            series.setdefault(NAMES.get(name, name), []).append({"bytes": size, **samples.plain()})
        at_image = found["zmq"] if size == IMAGE or at_image is None else at_image
    assert at_image is not None
    return [Result("fig5", at_image.median, "µs", RAN, details={"series": series, "not_available": missing})]


def _timed(bench: Run, size: int, contestants: Mapping[str, Batch]) -> dict[str, Samples]:
    slow = {name for name, batch in contestants.items() if batch(2)[1] > SLOW_US}
    fast = {name: batch for name, batch in contestants.items() if name not in slow}
    found = interleave(fast, bench.plan(50 if size < 1 << 20 else 10, rounds=10))
    return found | interleave({name: contestants[name] for name in slow}, bench.plan(2, rounds=5, warm=0))
