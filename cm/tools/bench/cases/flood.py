# SPDX-License-Identifier: Apache-2.0
"""How long a client waits for answers while another floods the manager, compared with being alone, and with being
beside processes that compute as much as a flood does but ask for nothing: what it waits there, the kernel gives others.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from cm import child
from cm.client.board import Board
from cm.client.core import calls
from cm.tools.bench.machine import unpinned
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Samples, interleave, timed
from cm.tools.bench.run import Run
from cm.tools.bench.serving import Served, environment, resident_mib, serve, settle

REGISTER = "focus"
BESIDE = (
    ", while another process has answers that it does not read, "
    "uploads, 64 slots, 900 subscriptions, 32 leases and 207 connections, over 100 of which it asks for the status, "
    "1024 writes, all registers and text of 64 KiB, "
    "and repeats each kind of packet on the data socket, reads of registers on 8 of its connections "
    "(cm/tools/bench/flooding.py)"
)
_BUSY = 2  # a flood computes in two threads: its own, and ZeroMQ's
_COMPUTES = "import os; parent = os.getppid()\nwhile os.getppid() == parent: sum(range(100000))"
RAN = {
    "flood": "board.registers[name] as a program uses it: over the data socket, by a request where that has no answer",
    "flood_requests": "the same read as a request over ZeroMQ (cm_read_reg), Python client",
}


def run(bench: Run) -> list[Result]:
    """Measure `flood` and `flood_requests`, and each beside being alone, and beside processes that only compute."""
    plan = bench.plan(200)
    with ExitStack() as stack:
        if bench.cpus:  # on a single CPU the flood's own work would be measured
            stack.enter_context(unpinned(set(bench.cpus)))
        served = stack.enter_context(serve(bench))
        board = stack.enter_context(served.connect())
        settle(board)
        read = calls.read_registers((REGISTER,))
        ways = {"flood": timed(lambda: board.registers[REGISTER]), "flood_requests": timed(lambda: board.ask(read))}
        for _ in range(plan.warm):
            for batch in ways.values():
                batch(plan.trips)
        before = resident_mib(served.pid)
        quiet = interleave(ways, plan)
        with _computing(bench):
            busy = interleave(ways, plan)
        asked = _requests(board)
        with _flooding(bench, served) as told:
            beside = interleave(ways, plan)
            most = resident_mib(served.pid)
            asked = _requests(board) - asked - 1
    own = (plan.trips + plan.warm) * plan.rounds
    details = {"memory_mib": {"idle": before, "flood": most}, "by_request": (asked - own) / own, "flood": told}
    return [result for name in ways for result in _results(name, quiet[name], busy[name], beside[name], details)]


def _results(name: str, quiet: Samples, busy: Samples, beside: Samples, details: dict[str, Any]) -> list[Result]:
    """`details` say how large a part of the reads over the data socket became requests."""
    slow, ran = beside.p99, RAN[name] + BESIDE
    details = {"samples": {"quiet": _plain(quiet), "busy": _plain(busy), "flood": _plain(beside)}, **details}
    return [
        Result(name, slow / 1000, "ms", ran + "; 99 of 100 answers", goal=Goal(50.0), details=details),
        _beside(f"{name}_vs_quiet", slow, quiet.p99, ran + "; baseline: the same, alone"),
        _beside(f"{name}_vs_busy", slow, busy.p99, f"{ran}; baseline: the same beside {_BUSY} processes that compute"),
    ]


def _beside(name: str, slow: float, baseline: float, ran: str) -> Result:
    return Result(name, slow, "µs", ran, baseline=baseline, ratio=slow / baseline, goal=Goal(3.0))


def _requests(board: Board) -> int:
    """How many this process has made so far."""
    return sum(client.requests for client in board.clients() if f"pid {os.getpid()}" in client.name)


def _plain(samples: Samples) -> dict[str, float | int]:
    return {**samples.plain(), "slowest": max(samples.all)}


@contextmanager
def _computing(bench: Run) -> Iterator[None]:
    """Processes that only compute, while the context lasts."""
    with ExitStack() as stack:
        for _ in range(_BUSY):
            process = subprocess.Popen([sys.executable, "-c", _COMPUTES], env=environment(bench))
            stack.callback(process.wait)
            stack.callback(process.kill)
        yield


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
