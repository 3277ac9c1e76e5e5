# SPDX-License-Identifier: Apache-2.0
"""Rounds over both stores: five boards change, and at a phase of it something is killed, stopped, or cut off.

Each phase meets each fault, in an order that is drawn; as root, in network namespaces and through a switch of the
test's own. Two boards' clocks are a day off. What is told of a change is held against what the managers say; no two
boards have different views of a generation, none executes an older one than before, none is undecided for longer than
the lease and 5 s, and what all clients saw of the store is linearizable.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import random
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from fleet_etcd import EtcdCluster, Member
from fleet_history import Recording, linearizable, read
from fleet_support import CLOCK, FleetBoard, Router, fleet_board
from manager_process import REPOSITORY, environment, until
from networks import HOST, Networks, needs_root

import cm.fleet
import cm.networks.fleet.store
from cm.networks.fleet.coordinator import SETTLED
from cm.wire.messages.fleet import BoardStatus

BOARDS = ("b1", "b2", "b3", "b4", "b5")
KEEPER = BOARDS[0]
MODES = ("default", "edge_detection", "colorise")
PHASES = ("open", "prepare", "apply", "decide", "reconcile")
BUSY = 60.0  # further seconds on a machine that others keep busy
CLOCKS = {"b2": "-86400", "b4": "86400"}
ON = ("a board", "the coordinator", "the store")
FAULTS = [
    *itertools.product(("killed", "stopped", "cut off", "deaf", "dumb"), ON),
    ("flapping", "a board"), ("at 128 kbit/s", "a board"), ("full", "the store's disk"),
    ("standing still", "the middle"), ("50 ± 30 ms, 5 % lost, 10 % overtaken, 2 % twice", "everything"),
]  # fmt: skip
COORDINATOR = """
import asyncio, json, sys
import cm.fleet
import cm.networks.fleet.store
from cm.networks.fleet.errors import ChangeFailed
from cm.errors import CmError
from fleet_history import Recording

async def main(router, store, name, path, mode, policy, phase, known):
    left = {phase}

    async def stop(where):
        if where in left:
            left.clear()
            print(where, flush=True)
            await asyncio.to_thread(sys.stdin.readline)

    class Stopping(Recording):
        async def txn(self, expect, puts):
            await stop("decide")
            return await super().txn(expect, puts)

        async def claim(self, *asked):
            await stop("open")
            return await super().claim(*asked)

    def told(course):
        decision = course.decision.value if course.decision else None
        said = {"generation": course.generation, "decision": decision, "differing": course.differing}
        print(json.dumps(said), flush=True)

    with open(path, "a") as file:
        async with cm.fleet.aio.connect(router, store=store, caller=name, timeout=20.0) as fleet:
            fleet._store, steps = Stopping(fleet._store, file), fleet._steps

            async def stopping(timeout, boards, verb, step):
                await stop(verb)
                async for each in steps(timeout, boards, verb, step):
                    yield each

            fleet._steps = stopping
            if known:
                fleet._known = await fleet._store.get("")
            try:
                told(await fleet.mode(mode, policy=policy, absent="go-on", timeout=20.0))
            except ChangeFailed as error:
                told(error.course)
            except CmError as error:
                print(json.dumps({"refused": str(error)}), flush=True)

asyncio.run(main(*sys.argv[1:]))
"""


@dataclass
class Seen:
    """What the boards said, all the time: each place that one reached, by generation."""

    places: dict[tuple[str, int], tuple[str, str]] = field(default_factory=dict)
    newest: dict[str, int] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    def saw(self, name: str, status: BoardStatus | None) -> None:
        if status is None or status.fleet is None or status.status.fpga_busy:
            return
        state, place = status.fleet, (status.status.config_name, status.status.mode)
        if state.state != "there" or place != (state.wanted_config, state.wanted_mode):
            return  # a status of the manager may be newer than what the bridge knows
        if self.places.setdefault((name, state.generation), place) != place:
            self.wrong.append(f"{name} has two views of generation {state.generation}")
        if state.generation < self.newest.get(name, 0):
            self.wrong.append(f"{name} went back to generation {state.generation} from {self.newest[name]}")
        self.newest[name] = state.generation


class Rounds:
    """A fleet of five over a store, the keeper or three members of etcd, and what happens to it."""

    def __init__(self, store: str, folder: Path, seed: int, stopped: float) -> None:
        self.kind, self.folder, self.chance, self.stopped = store, folder, random.Random(seed), stopped
        self.stack = contextlib.ExitStack()
        self.files: list[Path] = []
        self.seen = Seen()
        self.longest = 0.0
        self.members: list[Member] = []
        faults = [each for each in FAULTS if store == "keeper" or each[0] != "full"]
        pairs = list(itertools.product(PHASES, faults))
        self.chance.shuffle(pairs)
        self.course = itertools.cycle(pairs)

    def __enter__(self) -> Rounds:
        try:
            self._start()
        except BaseException:
            self.stack.close()
            raise
        return self

    def _start(self) -> None:
        members = ("m0", "m1", "m2") if self.kind == "etcd" else ()
        try:
            self.networks = self.stack.enter_context(Networks(("c", *members, *BOARDS)))
        except subprocess.CalledProcessError as error:
            pytest.skip(f"needs_namespaces: {error.stderr}")
        self.store = self._cluster() if members else "keeper"
        self.router = Router(host=self.networks.address(HOST))
        self.stack.callback(self.router.kill)
        (self.folder / "sitecustomize.py").write_text(CLOCK)
        where = ("--router", self.router.endpoint, "--store", self.store, "--join", "--lease", "3")
        self.disk = self._small_disk() if self.kind == "keeper" else self.folder
        more = {KEEPER: ("--keeper", "--state-dir", str(self.disk))} if self.kind == "keeper" else {}
        contexts = {
            name: fleet_board(
                name, where, more.get(name, ()), inside=self.networks.inside(name),
                variables={"PYTHONPATH": f"{self.folder}:{REPOSITORY}", "CM_TEST_AHEAD": CLOCKS.get(name, "0")},
            )
            for name in BOARDS
        }  # fmt: skip
        with ThreadPoolExecutor(3) as threads:
            opened = threads.map(lambda context: context.__enter__(), contexts.values())
            self.boards: dict[str, FleetBoard] = dict(zip(contexts, opened, strict=True))
        for context in contexts.values():
            self.stack.push(context)
        self.fleet = self.stack.enter_context(
            cm.fleet.connect(self.router.endpoint, store=self.store, caller="watcher", timeout=20.0)
        )
        until(self._listed)
        self.fleet.load("camera", "default")
        self.stack.enter_context(self._watched())
        self.stack.enter_context(self._read_on())

    def _cluster(self) -> str:
        options = ("--heartbeat-interval", "100", "--election-timeout", "1000")
        cluster = EtcdCluster(
            3, host=lambda number: self.networks.address(f"m{number}"),
            inside=lambda number: self.networks.inside(f"m{number}"), port=2379, options=options,
        )  # fmt: skip
        self.members = self.stack.enter_context(cluster).members
        return cluster.urls

    def _small_disk(self) -> Path:
        disk = self.folder / "disk"
        disk.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "own", str(disk)], check=True)
        self.stack.callback(subprocess.run, ["umount", "-l", str(disk)], check=False)
        return disk

    def _listed(self) -> bool:
        with contextlib.suppress(cm.networks.fleet.store.StoreAway):
            return set(self.fleet.inventory()) == set(BOARDS)
        return False

    def __exit__(self, *_: Any) -> None:
        self.stack.close()

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        over = threading.Event()
        with self.fleet.watch() as statuses:

            def follow() -> None:
                for name, status in statuses:
                    if over.is_set():
                        return
                    self.seen.saw(name, status)

            thread = threading.Thread(target=follow, daemon=True)
            thread.start()
            yield
            over.set()
            thread.join(BUSY)

    @contextlib.contextmanager
    def _read_on(self) -> Iterator[None]:
        """Two clients that read everything, again and again."""
        over, threads = threading.Event(), []
        for number in range(2):
            path = self._file(f"reader{number}")
            threads.append(threading.Thread(target=_reader, args=(self.router.endpoint, self.store, path, over)))
        for thread in threads:
            thread.start()
        yield
        over.set()
        for thread in threads:
            thread.join(BUSY)

    def _file(self, name: str) -> Path:
        self.files.append(self.folder / f"{name}.history")
        self.files[-1].touch()
        return self.files[-1]

    # ---- a round --------------------------------------------------------------------------------

    def one(self, number: int) -> str:
        """What happened, in a line."""
        phase, (how, what) = next(self.course)
        before = {name: board.place for name, board in self.boards.items()}
        mode = self.chance.choice([mode for mode in MODES if mode != before[KEEPER][1]])
        policy = self.chance.choice(("all", "quorum"))
        with self._coordinator(number, mode, policy, phase) as process:
            with self._fault(how, what, process):
                with contextlib.suppress(OSError):
                    process.stdin.write(b"\n")
                    process.stdin.flush()
                if how != "killed":
                    time.sleep(self.stopped)
            said, errors = process.communicate(timeout=SETTLED + 2 * BUSY)
        told = json.loads((said.decode().strip().splitlines() or ["null"])[-1])
        title = f"{number}: {mode} under {policy}, at {phase} {what} {how}"
        killed = (how, what) == ("killed", "the coordinator")
        if told is None and not killed:
            self.seen.wrong.append(f"{title}: {errors.decode()[-2000:]}")
        begun = time.monotonic()
        if told is not None:
            self.seen.wrong += [f"{title}: {told}, but {wrong}" for wrong in self._judged(told, before, mode)]
        try:
            until(self._settled, SETTLED + BUSY)
        except AssertionError:
            states = {name: getattr(each, "fleet", each) for name, each in self.fleet.status().items()}
            raise AssertionError(f"{title}: {told}, not settled: {states}") from None
        took = time.monotonic() - begun
        self.longest = max(self.longest, took)
        return f"{title}: {told or 'dead'}, settled in {took:.1f} s"

    def _judged(self, told: dict[str, Any], before: dict[str, tuple[str, str]], mode: str) -> Iterator[str]:
        """Where the boards are not as told, at the moment at which it was told."""
        kept = told.get("decision") == "keep"
        if "refused" in told and "is not known" in told["refused"]:
            return
        if "decision" in told and told["decision"] is None:
            return
        for name, board in self.boards.items():
            place = board.place
            if name not in told.get("differing", {}) and place != (("camera", mode) if kept else before[name]):
                yield f"{name} is in {place}"

    @contextlib.contextmanager
    def _coordinator(self, number: int, mode: str, policy: str, phase: str) -> Iterator[subprocess.Popen[bytes]]:
        """One that waits where the phase begins."""
        path = self._file(f"round{number}")
        command = [
            *self.networks.inside("c"), sys.executable, "-c", COORDINATOR, self.router.endpoint, self.store,
            f"anna{number}", str(path), mode, policy, phase, self.chance.choice(("", "known")),
        ]  # fmt: skip
        env, pipe = environment(PYTHONPATH=f"{REPOSITORY}:{REPOSITORY / 'tests'}"), subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, env=env, cwd="/") as process:
            assert process.stdout is not None
            assert select.select([process.stdout], [], [], BUSY)[0]
            assert process.stdout.readline() == f"{phase}\n".encode()
            yield process

    @contextlib.contextmanager
    def _fault(self, how: str, what: str, process: subprocess.Popen[bytes]) -> Iterator[None]:
        """What happens, and its mending."""
        leader = next((m for m in self.members if _leads(m)), None)
        board = self.boards[self.chance.choice(BOARDS[1:])]
        target: Any = {"a board": board.bridge, "the coordinator": process}.get(what)
        name = {"a board": board.name, "the coordinator": "c", "the middle": HOST}.get(what, KEEPER)
        if what == "the store":
            target, name = (leader, leader.name) if leader else (self.boards[KEEPER].bridge, KEEPER)
        if how == "killed":
            {"the coordinator": process.kill}.get(what, getattr(target, "end", None) or getattr(target, "kill", None))()
            yield
            if what != "the coordinator":
                target.start()
        elif how == "stopped":
            send = process.send_signal if what == "the coordinator" else target.send
            send(signal.SIGSTOP)
            yield
            send(signal.SIGCONT)
        elif how == "full":
            with _filled(self.disk):
                yield
        elif how == "flapping":
            flap = threading.Timer(0, self._flap, (name, over := threading.Event()))
            flap.start()
            yield
            over.set()
            flap.join()
        else:
            self._hurt(how, name)
            yield
        self.networks.mend()

    def _hurt(self, how: str, name: str) -> None:
        if how.startswith("50"):
            self.networks.set("*", delay=0.05, jitter=0.03, loss=0.05, reorder=0.1, double=0.02)
        elif how.endswith("kbit/s"):
            self.networks.set(name, rate=128e3)
        else:
            self.networks.cut(name, {"deaf": "in", "dumb": "out"}.get(how, "both"))

    def _flap(self, name: str, over: threading.Event) -> None:
        while not over.wait(0.5):
            self.networks.cut(name)
            over.wait(0.5)
            self.networks.mend()

    def _settled(self) -> bool:
        """Every board is where it is wanted, and knows it."""
        with contextlib.suppress(cm.networks.fleet.store.StoreAway, cm.networks.fleet.store.StoreRefused):
            wanted = self.fleet.inventory()
            statuses = self.fleet.status(list(BOARDS))
            return all(
                isinstance(status, BoardStatus)
                and status.fleet is not None
                and (status.fleet.state, status.fleet.store_error) == ("there", "")
                and status.fleet.generation == wanted[name].generation
                for name, status in statuses.items()
            )
        return False


def _leads(member: Member) -> bool:
    done = subprocess.run(
        ["etcdctl", "--endpoints", member.client, "--command-timeout", "2s", "endpoint", "status", "-w", "json"],
        env={**os.environ, "ETCDCTL_API": "3"}, capture_output=True, check=False,
    )  # fmt: skip
    with contextlib.suppress(ValueError, KeyError, IndexError, TypeError):
        status = json.loads(done.stdout)[0]["Status"]
        return bool(status["leader"] == status["header"]["member_id"])
    return False


def _reader(router: str, store: str, path: Path, over: threading.Event) -> None:
    with path.open("a") as file, cm.fleet.connect(router, store=store, caller="reader") as fleet:
        fleet._fleet._store = Recording(fleet._fleet._store, file)  # type: ignore[assignment]
        while not over.wait(0.2):
            with contextlib.suppress(cm.networks.fleet.store.StoreAway):
                fleet.stored()


@contextlib.contextmanager
def _filled(disk: Path) -> Iterator[None]:
    """To the last byte."""
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file:
        for size in (65536, 512, 1):
            with contextlib.suppress(OSError):
                while file.write(b"x" * size) == size:
                    pass
    try:
        yield
    finally:
        ballast.unlink()


@needs_root
@pytest.mark.timeout(0)
@pytest.mark.parametrize("store", ["keeper", "etcd"])
def test_in_every_round_what_is_told_is_so_and_all_boards_end_where_they_are_wanted(
    store: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    rounds, seed = request.config.getoption("--fleet-rounds"), request.config.getoption("--seed")
    with Rounds(store, tmp_path, seed, request.config.getoption("--stopped")) as world:
        for number in range(rounds):
            print(world.one(number), flush=True)
            assert not world.seen.wrong, world.seen.wrong
        assert all(process.bridge.process is not None for process in world.boards.values())
    history = list(read(world.files))
    print(f"{store}, seed {seed}: {rounds} rounds; at the longest {world.longest:.1f} s; {len(history)} operations")
    assert len(history) > rounds
    begun = min(each.begun for each in history)
    start = next(each.seen for each in sorted(history, key=lambda each: each.begun) if each.kind == "get")
    assert linearizable(history, start), f"no order fits what clients saw since {begun}"
    if os.getloadavg()[0] <= (os.cpu_count() or 1):
        assert world.longest <= SETTLED
