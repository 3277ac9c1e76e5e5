# SPDX-License-Identifier: Apache-2.0
"""How long a client waits for answers while another floods the manager, compared with being alone."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from cm import child
from cm.tools.bench.machine import unpinned
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Samples, timed
from cm.tools.bench.run import Run
from cm.tools.bench.serving import Served, environment, resident_mib, serve, settle

REGISTER = "focus"
RAN = (
    "cm_read_reg of one register through the Python client, while another process has answers that it does not read, "
    "uploads, 64 slots, 900 subscriptions, 32 leases and 207 connections, over 100 of which it asks for the status, "
    "1024 writes, all registers and text of 64 KiB, "
    "and repeats each kind of packet on the data socket (cm/tools/bench/flooding.py); baseline: the same, alone"
)


def run(bench: Run) -> list[Result]:
    """Measure `flood` and `flood_vs_quiet`."""
    plan = bench.plan(200)
    with ExitStack() as stack:
        if bench.cpus:  # on a single CPU the flood's own work would be measured
            stack.enter_context(unpinned(set(bench.cpus)))
        served = stack.enter_context(serve(bench))
        board = stack.enter_context(served.connect())
        settle(board)
        batch = timed(lambda: board.registers[REGISTER])
        for _ in range(plan.warm):
            batch(plan.trips)
        before = resident_mib(served.pid)
        quiet = Samples(tuple(batch(plan.trips) for _ in range(plan.rounds)))
        with _flooding(bench, served) as told:
            beside = Samples(tuple(batch(plan.trips) for _ in range(plan.rounds)))
            most = resident_mib(served.pid)
    details = {
        "samples": {"quiet": _plain(quiet), "flood": _plain(beside)},
        "memory_mib": {"idle": before, "flood": most},
        "flood": told,
    }
    slow, alone = beside.p99, quiet.p99
    return [
        Result("flood", slow / 1000, "ms", RAN + "; 99 of 100 answers", goal=Goal(50.0), details=details),
        Result("flood_vs_quiet", slow, "µs", RAN, baseline=alone, ratio=slow / alone, goal=Goal(3.0)),
    ]


def _plain(samples: Samples) -> dict[str, float | int]:
    return {**samples.plain(), "slowest": max(samples.all)}


@contextmanager
def _flooding(bench: Run, served: Served) -> Iterator[dict[str, Any]]:
    """Flood the manager while the context lasts; what it yields holds the outcome afterwards."""
    words = child.command("cm.tools.bench.flooding", str(served.runtime_dir))
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    told: dict[str, Any] = {}
    with subprocess.Popen(words, env=environment(bench), **pipes) as process:  # type: ignore[call-overload]
        try:
            assert process.stdout.readline() == b"flooding\n"
            yield told
            told.update(json.loads(process.communicate()[0]))
        finally:
            process.kill()
