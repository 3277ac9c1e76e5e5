# SPDX-License-Identifier: Apache-2.0
"""A fleet of simulated boards on this machine: discovery, statuses of all, a change of all."""

from __future__ import annotations

import asyncio
import os
import statistics
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import cm
from cm.tools.bench import fleet_model, fleet_store
from cm.tools.bench.machine import unpinned
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run
from cm.tools.bench.serving import cpu_seconds, resident_mib
from cm.tools.demo.boards import LocalFleet, local_etcd, until

BOARDS = 50
NAMES = ("fleet_discovery", "fleet_status", "fleet_change", "fleet_model")
_PATIENCE = 300.0
_PORT = 1e6  # bytes a second of each board's port: a load takes 0.27 s by a clock, and no processor
_REST = 0.5  # seconds after a change, in which bridges say and see what has changed
_DISCOVERY, _FAN_IN = Goal(2.0), Goal(10.0)
_RAN = {
    "fleet_discovery": "a client that connects to the router of {n} boards, until it knows all of them (median)",
    "fleet_status": "a client that follows the statuses of {n} boards, each told once a second: percent of one CPU",
    "fleet_change": "a change of mode of {n} boards under the policy `all`, planned and kept (median)",
    "fleet_model": "boards that one client can follow at 1 Hz within one CPU, from the figures beside it",
}


def run(bench: Run) -> list[Result]:
    """Measure all of `NAMES`, on boards that are started once."""
    count = bench.boards or (3 if bench.quick else BOARDS)
    with unpinned(set(bench.cpus) or {0}), _fleet(bench, count) as (local, fleet):
        if set(bench.names) & set(NAMES) == {"fleet_change"}:
            return [_change(local, fleet, bench, count)]
        found = [
            _discovery(local, bench, count),
            _status(local, fleet, bench, count),
            _change(local, fleet, bench, count),
        ]
    return [*found, _model(found, count, bench)]


def _result(name: str, value: float, unit: str, count: int, goal: Goal | None, details: dict[str, Any]) -> Result:
    return Result(name, value, unit, _RAN[name].format(n=count), goal=goal, details={"boards": count, **details})


@contextmanager
def _fleet(bench: Run, count: int) -> Iterator[tuple[LocalFleet, Any]]:
    from cm.fleet import connect

    with ExitStack() as stack:
        etcd = stack.enter_context(local_etcd(bench.place("etcd"))) if bench.store == "etcd" else ""
        names, slow = [f"b{n:03}" for n in range(count)], ("--sim-icap-rate", str(_PORT))
        local = stack.enter_context(LocalFleet(names, bench.place("f"), store=etcd, manager=slow))
        fleet = stack.enter_context(connect(local.router, caller="bench", timeout=60.0, store=etcd or "keeper"))
        until(
            lambda: len(fleet.boards()) == count and all(map(_ready, fleet.status().values())),
            "the fleet did not come up", _PATIENCE,
        )  # fmt: skip
        yield local, fleet


def _ready(status: Any) -> bool:
    own = getattr(status, "status", None)
    return own is not None and bool(own.mode) and not own.fpga_busy


def _discovery(local: LocalFleet, bench: Run, count: int) -> Result:
    from cm.fleet import connect

    seconds = []
    for _ in range(2 if bench.quick else 10):
        begun = time.monotonic()
        with connect(local.router, caller="bench", timeout=60.0) as fleet:
            while len(fleet.boards()) < count:
                time.sleep(0.001)
            seconds.append(time.monotonic() - begun)
    return _result("fleet_discovery", statistics.median(seconds), "s", count, _DISCOVERY, {"slowest": max(seconds)})


def _status(local: LocalFleet, fleet: Any, bench: Run, count: int) -> Result:
    """What the client's process uses; that of router, bridges and managers stands beside it."""
    seconds = 3.0 if bench.quick else 20.0
    others = _processes(local)
    with fleet.watch() as statuses:
        for _ in range(2 * count):
            next(statuses)
        quiet, begun, told = _used(others), time.monotonic(), 0
        while time.monotonic() < begun + seconds:
            next(statuses)
            told += 1
        took = time.monotonic() - begun
        percent = {kind: 100 * (used - quiet[kind]) / took for kind, used in _used(others).items()}
    details = {
        "statuses_per_second": told / took,
        "bytes_of_a_status": _bytes_of_a_status(local),
        "router_percent": percent["router"],
        "router_mib": resident_mib(local.router_process.pid),
        "percent_of_one_bridge": percent["bridges"] / count,
        "bridge_mib": statistics.median(map(resident_mib, others["bridges"])),
        "percent_of_one_manager": percent["managers"] / count,
        "load": os.getloadavg()[0],
    }
    return _result("fleet_status", percent["client"], "% of a CPU", count, _FAN_IN, details)


def _processes(local: LocalFleet) -> dict[str, list[int]]:
    return {
        "client": [os.getpid()],
        "router": [local.router_process.pid],
        "bridges": [b.bridge.pid for b in local.boards.values() if b.bridge],
        "managers": [b.manager.pid for b in local.boards.values() if b.manager],
    }


def _used(processes: dict[str, list[int]]) -> dict[str, float]:
    """Processor time so far, seconds."""
    return {kind: sum(map(cpu_seconds, pids)) for kind, pids in processes.items()}


def _bytes_of_a_status(local: LocalFleet) -> int:
    """The size of a status on the network, without zenoh's own headers."""
    from cm.networks.fleet.zenoh_session import Network, session

    name = next(iter(local.boards))
    with session(Network(connect=(local.router,))) as plain:
        (reply,) = plain.get(f"cm/{name}/status", timeout=60.0)
        return len(bytes(reply.ok.payload))


def _change(local: LocalFleet, fleet: Any, bench: Run, count: int) -> Result:
    """Change back and forth; in turns, all boards load the same without a fleet, each asked by itself at one time.

    The critical path is that of the median change. Boards share this machine's processors; what a change costs where
    each has its own is reckoned from changes in which they are asked one after the other.
    """
    courses, used, alone, processes = [], [], [], _processes(local)

    def together(mode: str) -> None:
        before, begun = _used(processes), time.monotonic()
        course = fleet.mode(mode, timeout=120.0)
        courses.append((time.monotonic() - begun, course))
        used.append({kind: now - before[kind] for kind, now in _used(processes).items()})

    with ExitStack() as stack, ThreadPoolExecutor(count) as threads:
        boards = [stack.enter_context(cm.connect(runtime_dir=each.runtime_dir)) for each in local.boards.values()]

        def apart(mode: str) -> None:
            begun = time.monotonic()
            list(threads.map(lambda board: board.load(mode=mode, timeout=120.0), boards))
            alone.append(time.monotonic() - begun)

        for _ in range(1 if bench.quick else 6):  # each way goes to both modes as often as the other
            for change, mode in (
                (together, "edge_detection"), (apart, "default"), (apart, "edge_detection"), (together, "default"),
            ):  # fmt: skip
                change(mode)
                time.sleep(_REST)
    courses.sort(key=lambda each: each[0])
    seconds, course = courses[len(courses) // 2]
    loads = sorted(state.seconds for state in course.figures.values())
    cpu = {kind: statistics.median(each[kind] for each in used) for kind in processes}
    details = {
        "store": bench.store,
        "beyond_the_loads_ms": (statistics.median(s for s, _ in courses) - statistics.median(alone)) * 1000,
        "critical_path": {leg.phase: {"ms": leg.seconds * 1000, "last": leg.slowest} for leg in course.legs},
        "with_a_processor_each": asyncio.run(_in_turns(local, bench, cpu["client"])),
        "load_of_the_median_board_ms": loads[len(loads) // 2] * 1000,
        "load_of_the_slowest_board_ms": loads[-1] * 1000,
        "client_cpu_ms": cpu["client"] * 1000,
        "router_cpu_ms": cpu["router"] * 1000,
        "bridge_cpu_ms_a_board": cpu["bridges"] / count * 1000,
        "manager_cpu_ms_a_board": cpu["managers"] / count * 1000,
        "slowest_change_ms": courses[-1][0] * 1000,
    }
    found = _result("fleet_change", seconds * 1000, "ms", count, None, details)
    return replace(found, baseline=statistics.median(alone) * 1000)


async def _in_turns(local: LocalFleet, bench: Run, client: float) -> dict[str, float]:
    """What a change costs beyond its slowest load where no board waits for a processor: medians, ms.

    The store's share is measured as it is; of each phase the median board counts, asked while no other is at work (that
    one was slower is this machine's doing); the client, which works for all of them, counts with all of its processor
    time: `client`, in seconds.
    """
    from cm.networks.fleet import aio, queries
    from cm.networks.fleet.coordinator import Coordinator
    from cm.networks.fleet.keeper import opened_store
    from cm.networks.fleet.store import Entry
    from cm.networks.fleet.zenoh_session import Network
    from cm.wire.encode import encoded
    from cm.wire.messages.fleet import FleetState, FleetStep

    found: dict[str, list[float]] = {}
    where = local.store or "keeper"
    async with aio.connect(local.router, caller="bench", timeout=60.0, store=where) as fleet:
        store = opened_store(Network(store=where), fleet.session, "bench")
        known: Mapping[str, Entry] = {}
        for number in range(2 if bench.quick else 8):
            took: dict[str, list[float]] = {}

            async def ask(
                boards: Sequence[str], verb: str, step: FleetStep, took: dict[str, list[float]] = took
            ) -> AsyncIterator[tuple[str, Any]]:
                for board in boards:
                    begun = time.monotonic()
                    said = queries.said(await fleet.do(verb, board, encoded(step)), FleetState)
                    took.setdefault(verb, []).append(time.monotonic() - begun)
                    if verb == "apply" and isinstance(said, FleetState):
                        took[verb][-1] -= said.seconds
                    yield board, said

            mode = ("edge_detection", "default")[number % 2]
            change = Coordinator(
                store, ask, "bench", f"turns-{number}", lambda _: (sorted(local.boards), {}), "", mode, known=known
            )
            course, known = await change.run(), change.known
            legs = {leg.phase: leg.seconds for leg in course.legs} | {
                verb: statistics.median(each) for verb, each in took.items()
            }
            for phase, seconds in {**legs, "client": client, "beyond": sum(legs.values()) + client}.items():
                found.setdefault(phase, []).append(seconds * 1000)
            await asyncio.sleep(_REST)
        await store.close()
    return {phase: statistics.median(each) for phase, each in found.items()}


def _model(found: list[Result], count: int, bench: Run) -> Result:
    discovery, status, change = (result.details for result in found)
    measured = fleet_model.Measured.of(count, found[0].value or 0.0, found[1].value or 0.0, status, change)
    rows = [fleet_model.reckoned(measured, boards) for boards in fleet_model.SIZES]
    alone = measured.statuses_of_a_cpu
    stores = fleet_store.rows(bench.place("stores"), fleet_store.SIZES[: 2 if bench.quick else None])
    return _result(
        "fleet_model", alone, "boards", count, None, {"rows": rows, "discovery": dict(discovery), "stores": stores}
    )
