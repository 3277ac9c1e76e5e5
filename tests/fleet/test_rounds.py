# SPDX-License-Identifier: Apache-2.0
"""Rounds over a cluster of three: five boards change, and something is killed, stopped, or cut off meanwhile.

What is drawn: the leader, a follower, the coordinator or a bridge; SIGKILL, SIGSTOP, or a cut of its network (as root,
in namespaces of the test's own). The clocks of two boards are a day off. In no round do two boards have different views
of a generation, does one execute an older generation than before, or is one undecided longer than the lease and 5 s.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from fleet_etcd import EtcdCluster, Member
from fleet_history import Recording, linearizable, read
from fleet_support import CLOCK, FleetBoard, Router, fleet_board
from manager_process import REPOSITORY, environment, until

import cm.fleet
import cm.networks.fleet.store
from cm.networks.fleet.coordinator import LEASE
from cm.tools.demo.boards import free_ports
from cm.wire.messages.fleet import BoardStatus

BOARDS = ("b1", "b2", "b3", "b4", "b5")
MODES = ("default", "edge_detection", "colorise")
ENDS = LEASE + 5.0
BUSY = 60.0  # further seconds on a machine that others keep busy
CLOCKS = {"b2": "-86400", "b4": "86400"}
COORDINATOR = """
import asyncio, json, sys
import cm.fleet
import cm.networks.fleet.store
from cm.networks.fleet.errors import ChangeFailed, FleetRefused
from cm.errors import CmError
from fleet_history import Recording

async def main(router, store, name, path, mode, policy):
    with open(path, "a") as file:
        async with cm.fleet.aio.connect(router, store=store, caller=name, timeout=20.0) as fleet:
            fleet._store = Recording(fleet._store, file)
            print("begun", flush=True)
            try:
                course = await fleet.mode(mode, policy=policy, absent="go-on", timeout=20.0)
            except ChangeFailed as error:
                course = error.course
            except CmError as error:
                return print(json.dumps({"refused": str(error)}), flush=True)
            decision = course.decision.value if course.decision else None
            print(json.dumps({"generation": course.generation, "decision": decision}), flush=True)

asyncio.run(main(*sys.argv[1:]))
"""


class Networks:
    """A namespace for each process that may be cut off, joined by a bridge of this test's own; nothing without root."""

    def __init__(self, names: Sequence[str]) -> None:
        self.there = os.geteuid() == 0 and shutil.which("ip") is not None
        self._mark = f"cm{os.getpid() % 10000:04}"
        third = os.getpid() % 200
        self.host = f"198.18.{third}.1" if self.there else "127.0.0.1"
        self._addresses = {name: f"198.18.{third}.{10 + number}" for number, name in enumerate(names)}

    def __enter__(self) -> Networks:
        if self.there:
            try:
                self._build()
            except subprocess.CalledProcessError:  # a container that may not
                self.__exit__()
                self.there, self.host = False, "127.0.0.1"
        return self

    def _build(self) -> None:
        _ip(f"link add {self._mark} type bridge")
        _ip(f"addr add {self.host}/24 dev {self._mark}")
        _ip(f"link set {self._mark} up")
        for name, address in self._addresses.items():
            space, wire = f"{self._mark}-{name}", f"{self._mark}{name}"
            _ip(f"netns add {space}")
            _ip(f"link add {wire} type veth peer name eth0 netns {space}")
            _ip(f"link set {wire} master {self._mark} up")
            for command in (f"addr add {address}/24 dev eth0", "link set eth0 up", "link set lo up"):
                _ip(f"-n {space} {command}")

    def __exit__(self, *_: object) -> None:
        for name in self._addresses:
            subprocess.run(["ip", "netns", "del", f"{self._mark}-{name}"], check=False, capture_output=True)
        subprocess.run(["ip", "link", "del", self._mark], check=False, capture_output=True)

    def address(self, name: str, number: int) -> str:
        return self._addresses[name] if self.there else f"127.0.0.{1 + number}"

    def inside(self, name: str) -> tuple[str, ...]:
        return ("ip", "netns", "exec", f"{self._mark}-{name}") if self.there else ()

    def cut(self, name: str, whole: bool) -> None:
        _ip(f"link set {self._mark}{name} {'up' if whole else 'down'}")


def _ip(command: str) -> None:
    subprocess.run(["ip", *command.split()], check=True, capture_output=True)


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
    """A fleet of five over three members of etcd, and what happens to it."""

    def __init__(self, folder: Path, seed: int, stopped: float) -> None:
        self.folder, self.chance, self.stopped = folder, random.Random(seed), stopped
        self.stack = contextlib.ExitStack()
        self.files: list[Path] = []
        self.seen = Seen()
        self.longest = 0.0

    def __enter__(self) -> Rounds:
        try:
            self._start()
        except BaseException:
            self.stack.close()
            raise
        return self

    def _start(self) -> None:
        names = ("m0", "m1", "m2", *BOARDS)
        self.networks = self.stack.enter_context(Networks(names))
        self.cluster = self.stack.enter_context(
            EtcdCluster(
                3, host=lambda n: self.networks.address(f"m{n}", n), inside=lambda n: self.networks.inside(f"m{n}"),
                port=free_ports(2), options=("--heartbeat-interval", "100", "--election-timeout", "1000"),
            )
        )  # fmt: skip
        self.router = Router(host=self.networks.host)
        self.stack.callback(self.router.kill)
        (self.folder / "sitecustomize.py").write_text(CLOCK)
        where = ("--router", self.router.endpoint, "--store", self.cluster.urls, "--join", "--lease", "3")
        contexts = {
            name: fleet_board(
                name, where, inside=self.networks.inside(name),
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
            cm.fleet.connect(self.router.endpoint, store=self.cluster.urls, caller="watcher", timeout=20.0)
        )
        until(lambda: set(self.fleet.inventory()) == set(BOARDS))
        self.fleet.load("camera", "default")
        self.stack.enter_context(self._watched())
        self.stack.enter_context(self._read_on())

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
            threads.append(threading.Thread(target=_reader, args=(self.router.endpoint, self.cluster.urls, path, over)))
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
        mode, policy = self.chance.choice(MODES), self.chance.choice(("all", "quorum"))
        victim = self.chance.choice(("leader", "follower", "coordinator", "bridge"))
        how = self.chance.choice(("killed", "stopped", "cut off") if self.networks.there else ("killed", "stopped"))
        if victim == "coordinator" and how == "cut off":
            how = "stopped"
        pause = self.chance.uniform(0.0, 0.35)
        with self._coordinator(number, mode, policy) as process:
            time.sleep(pause)
            member, board = self._member(victim), self.boards[self.chance.choice(BOARDS)]
            name = {"coordinator": "coordinator", "bridge": board.name}.get(victim, member.name)
            mended = self._hurt(victim, how, member, board, process)
            mended()
            said, _ = process.communicate(timeout=ENDS + BUSY)
        begun = time.monotonic()
        until(self._settled, ENDS + BUSY)
        took = time.monotonic() - begun
        self.longest = max(self.longest, took)
        result = said.decode().strip().splitlines()
        return (
            f"{number}: {mode} under {policy}, {victim} {name} {how}: {result[-1:] or 'dead'}, settled in {took:.1f} s"
        )

    @contextlib.contextmanager
    def _coordinator(self, number: int, mode: str, policy: str) -> Iterator[subprocess.Popen[bytes]]:
        path = self._file(f"round{number}")
        command = [
            sys.executable, "-c", COORDINATOR, self.router.endpoint, self.cluster.urls, f"anna{number}", str(path),
            mode, policy,
        ]  # fmt: skip
        env = environment(PYTHONPATH=f"{REPOSITORY}:{REPOSITORY / 'tests'}")
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=env, cwd="/") as process:
            assert process.stdout is not None
            assert select.select([process.stdout], [], [], BUSY)[0]
            assert process.stdout.readline() == b"begun\n"
            yield process

    def _member(self, victim: str) -> Member:
        leader = next((m for m in self.cluster.members if _leads(m)), self.cluster.members[0])
        return leader if victim == "leader" else next(m for m in self.cluster.members if m is not leader)

    def _hurt(self, victim: str, how: str, member: Member, board: FleetBoard, process: subprocess.Popen[bytes]) -> Any:
        """Do it, for a while; what mends it."""
        if how == "cut off":
            name = board.name if victim == "bridge" else member.name
            self.networks.cut(name, whole=False)
            time.sleep(self.stopped)
            return lambda: self.networks.cut(name, whole=True)
        if victim == "coordinator":
            process.send_signal(signal.SIGKILL if how == "killed" else signal.SIGSTOP)
            if how == "stopped":
                time.sleep(self.stopped)
                process.send_signal(signal.SIGCONT)
            return lambda: None
        target: Any = board.bridge if victim == "bridge" else member
        if how == "killed":
            (target.end if victim == "bridge" else target.kill)()
            return target.start
        target.send(signal.SIGSTOP)
        time.sleep(self.stopped)
        return lambda: target.send(signal.SIGCONT)

    def _settled(self) -> bool:
        """Every board is where it is wanted, and knows it."""
        with contextlib.suppress(cm.networks.fleet.store.StoreAway):
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


@pytest.mark.timeout(0)
def test_in_every_round_all_boards_end_where_they_are_wanted(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    rounds, seed = request.config.getoption("--fleet-rounds"), request.config.getoption("--seed")
    with Rounds(tmp_path, seed, request.config.getoption("--stopped")) as world:
        for number in range(rounds):
            print(world.one(number), flush=True)
            assert not world.seen.wrong, world.seen.wrong
        assert all(process.bridge.process is not None for process in world.boards.values())
    history = list(read(world.files))
    print(f"{rounds} rounds; at the longest {world.longest:.1f} s; {len(history)} operations of clients")
    assert len(history) > rounds
    begun = min(each.begun for each in history)
    start = next(each.seen for each in sorted(history, key=lambda each: each.begun) if each.kind == "get")
    assert linearizable(history, start), f"no order fits what clients saw since {begun}"
    if os.getloadavg()[0] <= (os.cpu_count() or 1):
        assert world.longest <= ENDS
