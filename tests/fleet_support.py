# SPDX-License-Identifier: Apache-2.0
"""A fleet of simulated boards: a router, and for each board a manager and a bridge, all processes of their own."""

from __future__ import annotations

import contextlib
import hashlib
import os
import random
import select
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from manager_process import CAMERA, Manager, environment, short_folder, until

import cm.fleet
from cm import child
from cm.design.collect.collected import archive
from cm.networks.fleet.blocking import Fleet
from cm.simulation.software import Board as SimBoard
from cm.tools.demo.boards import free_ports

EDGE = random.Random(1).randbytes(150_000)
_SCHEMA = f"""
config:
  name: vision
  modules:
    edge: {{bitstream: edge.bin, sha256: {hashlib.sha256(EDGE).hexdigest()}}}
  modes:
    contours: {{modules: [edge]}}
"""
CLOCK = """
import os, time
_ahead, _time, _time_ns = float(os.environ.get("CM_TEST_AHEAD", "0")), time.time, time.time_ns
time.time = lambda: _time() + _ahead
time.time_ns = lambda: _time_ns() + int(_ahead * 1e9)
"""  # a sitecustomize.py, for a machine whose clock is so many seconds ahead
VISION = archive("vision", {"vision.yaml": _SCHEMA.encode(), "edge.bin": EDGE})  # an archive, not signed


class Router:
    """zenoh's router in a process, which can be killed."""

    def __init__(self, config: Path | None = None, listen: bool = True, host: str = "127.0.0.1") -> None:
        """`listen`: at `endpoint`; else where the file says."""
        self.endpoint = f"tcp/{host}:{free_ports()}"
        self._options = [
            *(("--listen", self.endpoint) if listen else ()),
            *(("--zenoh-config", config) if config else ()),
        ]
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        command = child.command("cm.cli.main", "fleet", "router", *map(str, self._options))
        self._process = subprocess.Popen(command, stderr=subprocess.PIPE, env=environment())
        assert self._process.stderr is not None
        assert self._process.stderr.readline() == b"cm fleet router: ready\n"

    def kill(self) -> None:
        assert self._process is not None
        assert self._process.stderr is not None
        self._process.kill()
        self._process.wait()
        self._process.stderr.close()


class Bridge:
    """``cm bridge fleet`` before one manager."""

    def __init__(self, folder: Path, name: str, manager: Manager, arguments: Sequence[str]) -> None:
        self.folder = folder
        self.name = name
        self.log = b""
        self.inside: tuple[str, ...] = ()  # what its command begins with
        self.variables: dict[str, str] = {}
        self._command = child.command(
            "cm.cli.main", "bridge", "fleet", "--runtime-dir", str(manager.runtime), "--name", name,
            "--state-dir", str(folder), *arguments,
        )  # fmt: skip
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, **variables: str) -> Bridge:
        command, env = [*self.inside, *self._command], environment(**{**self.variables, **variables})
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, env=env, cwd="/")
        assert self.process.stderr is not None
        self.log = b""
        while b"ready as" not in self.log:
            ready, _, _ = select.select([self.process.stderr], [], [], 60)
            piece = os.read(self.process.stderr.fileno(), 65536) if ready else b""
            assert piece, f"the bridge did not start: {self.log.decode()}"
            self.log += piece
        return self

    def send(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def end(self, number: int = signal.SIGKILL) -> None:
        if self.process is not None:
            assert self.process.stderr is not None
            self.send(signal.SIGCONT)
            self.send(number)
            os.set_blocking(self.process.stderr.fileno(), False)
            self.process.wait(timeout=60)
            self.log += self.process.stderr.read() or b""
            self.process.stderr.close()
            self.process = None


class FleetBoard:
    """A simulated board with everything that it needs to be part of a fleet."""

    def __init__(self, manager: Manager, sim: SimBoard, bridge: Bridge) -> None:
        self.manager = manager
        self.sim = sim
        self.bridge = bridge
        self.name = bridge.name

    @property
    def place(self) -> tuple[str, str]:
        with self.manager.connected() as board:
            return board.status.config_name, board.status.mode


@contextlib.contextmanager
def fleet_board(
    name: str,
    router: Sequence[str],
    arguments: Sequence[str] = (),
    schemas: Path = CAMERA,
    guests: str = '{"*": operate}',
    inside: Sequence[str] = (),
    variables: Mapping[str, str] | None = None,
) -> Iterator[FleetBoard]:
    """One board in its default mode; `router` are the bridge's options that lead to the fleet.

    `inside`: what the bridge's command begins with; `variables` of its environment.
    """
    with short_folder() as folder, SimBoard([schemas], root=folder / "board") as sim:
        (folder / "cm.yaml").write_text(f"access:\n  guests: {guests}\n")
        places = ("--config", str(schemas), "--root", str(sim.root), "--state-dir", str(folder / "state"))
        manager = Manager(folder / "run", *places, "--settings", str(folder / "cm.yaml"), "--name", name).start()
        bridge = Bridge(folder / "bridge", name, manager, (*router, *arguments))
        bridge.inside, bridge.variables = tuple(inside), dict(variables or {})
        bridge.start()
        try:
            with manager.connected() as board:
                board.load("camera", "default")
            yield FleetBoard(manager, sim, bridge)
        finally:
            bridge.end(signal.SIGTERM)
            manager.stop()


@contextlib.contextmanager
def fleet_boards(
    router: Sequence[str], arguments: dict[str, Sequence[str]], guests: str = '{"*": operate}'
) -> Iterator[dict[str, FleetBoard]]:
    """Boards by name, each with further arguments of its bridge, started together."""
    with contextlib.ExitStack() as stack:
        contexts = {name: fleet_board(name, router, more, guests=guests) for name, more in arguments.items()}
        with ThreadPoolExecutor(len(contexts)) as threads:
            found = dict(
                zip(contexts, threads.map(lambda context: context.__enter__(), contexts.values()), strict=True)
            )
        for context in contexts.values():
            stack.push(context)
        yield found


@contextlib.contextmanager
def fleet_of(
    arguments: dict[str, Sequence[str]], guests: str = '{"*": operate}', store: str = "keeper"
) -> Iterator[tuple[Router, dict[str, FleetBoard], Fleet]]:
    """A router, boards by name with further arguments of their bridges, and a client named anna.

    All are in the inventory; the first keeps the wanted state, if `store` says so.
    """
    keeper = ("--keeper",) if store == "keeper" else ()
    first = next(iter(arguments))
    options = {n: (*more, "--join", "--store", store, *(keeper if n == first else ())) for n, more in arguments.items()}
    with contextlib.ExitStack() as stack:
        router = Router()
        stack.callback(router.kill)
        found = stack.enter_context(fleet_boards(("--router", router.endpoint), options, guests))
        fleet = stack.enter_context(cm.fleet.connect(router.endpoint, caller="anna", timeout=30.0, store=store))
        until(lambda: set(fleet.boards()) == set(arguments), 60.0)
        until(lambda: set(fleet.inventory()) == set(arguments), 60.0)
        yield router, found, fleet
