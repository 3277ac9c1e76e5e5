# SPDX-License-Identifier: Apache-2.0
"""The paper's Fig. 5: latency against payload, ipc and tcp, and what the alternatives make of it."""

from __future__ import annotations

from contextlib import ExitStack

from cm.bench.result import Result
from cm.bench.rounds import Samples, interleave
from cm.bench.run import IMAGE, IMAGES, Rivals, Run

SIZES = (64, 4096, 65536, 1 << 20, *sorted(IMAGES))
KINDS = ("zmq", "zmq_tcp", "zenoh", "cyclonedds", "iceoryx2")
NAMES = {"zmq": "pyzmq ipc", "zmq_tcp": "pyzmq tcp", "zenoh": "zenoh, shared memory", "cyclonedds": "cyclonedds"}
RAN = "round trips between two processes by payload: pyzmq REQ/REP over ipc and tcp, and the baselines of the extra"


def run(bench: Run) -> list[Result]:
    """Measure `fig5`."""
    series: dict[str, list[dict[str, float]]] = {}
    missing: dict[str, str] = {}
    at_image: Samples | None = None
    for size in SIZES[:: 3 if bench.quick else 1]:
        with ExitStack() as stack:
            rivals = Rivals(bench, stack)
            rivals.add(KINDS, size)
            missing.update(rivals.missing)
            found = interleave(rivals.batches, bench.plan(50 if size < 1 << 20 else 10, rounds=10))
        for name, samples in found.items():
            series.setdefault(NAMES.get(name, name), []).append({"bytes": size, **samples.plain()})
        at_image = found["zmq"] if size == IMAGE or at_image is None else at_image
    assert at_image is not None
    return [Result("fig5", at_image.median, "µs", RAN, details={"series": series, "not_available": missing})]
