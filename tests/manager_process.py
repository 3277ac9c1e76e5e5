# SPDX-License-Identifier: Apache-2.0
"""A manager on a simulated board, as processes of their own: what users run."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import cm
from cm import child
from cm.simulation.software import Board as SimBoard

REPOSITORY = Path(__file__).resolve().parents[1]
CAMERA = REPOSITORY / "cm" / "data" / "camera"
_T = TypeVar("_T")


def environment(**variables: str) -> dict[str, str]:
    """The test's environment, with the package importable from the work tree."""
    return {**os.environ, "PYTHONPATH": str(REPOSITORY), **variables}


def until(condition: Callable[[], _T], timeout: float = 60.0) -> _T:
    """Poll for a condition that nothing announces; return its first true value."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.005)
    raise AssertionError("the condition did not come true in time")


def _as_a_service() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run under nohup(1)


def patient(folder: Path) -> Path:
    """The camera example, in `folder`, with a minute for each load: for boards whose port is `stalled`."""
    text, regions = re.subn(
        r"^    prr\d:\n", r"\g<0>      timeout: 60\n", (CAMERA / "camera.yaml").read_text(), flags=re.MULTILINE
    )
    assert regions == 2
    (folder / "patient").mkdir()
    (folder / "patient/camera.yaml").write_text(text)
    return folder / "patient"


@contextlib.contextmanager
def stalled(sim: SimBoard) -> Iterator[None]:
    """Stall the board's configuration port, so that a load lasts as long as the test wants."""
    sim.control.inject("icap_stall")
    try:
        yield
    finally:
        sim.control.clear("icap_stall")


class Manager:
    """A `cm serve` process."""

    def __init__(
        self, runtime: Path, *arguments: str, env: dict[str, str] | None = None, service: bool = False
    ) -> None:
        """`service`: without a terminal, and with signals as a service manager leaves them."""
        self.service = service
        self.runtime = runtime
        self.arguments = arguments
        self.env = env or environment()
        self.process: subprocess.Popen[bytes] | None = None
        self.log = b""

    @property
    def pid(self) -> int:
        """The id of the process, which must have been started."""
        assert self.process is not None
        return self.process.pid

    def tcp(self, endpoint: str = "pub") -> str:
        """The address of an endpoint over TCP, if the manager listens there."""
        endpoints = json.loads((self.runtime / "endpoints.json").read_text("ascii"))
        return str(endpoints["tcp"][0][endpoint])

    def start(self) -> Manager:
        command = child.command("cm.cli.main", "serve", "--runtime-dir", str(self.runtime), *self.arguments)
        options = {"start_new_session": True, "preexec_fn": _as_a_service} if self.service else {}
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, env=self.env, cwd="/", **options)  # type: ignore[call-overload]
        ready, self.log = child.said_until(self.process, b"ready at", 60)
        assert ready, f"the manager did not start: {self.log.decode()}"
        return self

    def kill(self) -> None:
        assert self.process is not None
        self.process.kill()
        self._reap()

    def stop(self) -> int:
        if self.process is None:
            return 0
        self.process.send_signal(signal.SIGTERM)
        return self._reap()

    def _reap(self) -> int:
        assert self.process is not None
        assert self.process.stderr is not None
        try:
            status = self.process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        os.set_blocking(self.process.stderr.fileno(), False)  # a simulator that lives on has it open too
        self.log += self.process.stderr.read() or b""
        self.process.stderr.close()
        self.process = None
        return status

    @contextlib.contextmanager
    def connected(self) -> Iterator[cm.Board]:
        with cm.connect(runtime_dir=self.runtime, timeout=60) as board:
            yield board


@contextlib.contextmanager
def short_folder() -> Iterator[Path]:
    """A folder in memory with a short name: socket paths are limited to 107 bytes."""
    parent = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="cm-t-", dir=parent) as folder:
        yield Path(folder)


@contextlib.contextmanager
def served(
    board: Sequence[str] = (),
    arguments: Sequence[str] = (),
    env: dict[str, str] | None = None,
    schemas: Path = CAMERA,
    settings: str = "",
) -> Iterator[tuple[Manager, SimBoard]]:
    """A board, and a manager on it with nothing loaded; the board outlives the manager.

    `board` and `arguments` are further ones of `cm sim` and `cm serve`, `env` is the manager's environment.
    """
    with short_folder() as folder, SimBoard([schemas], root=folder / "board", arguments=board) as sim:
        places = ["--config", str(schemas), "--root", str(sim.root), "--state-dir", str(folder / "state")]
        if settings:
            (folder / "cm.yaml").write_text(settings)
            places += ["--settings", str(folder / "cm.yaml")]
        manager = Manager(folder / "run", *places, *arguments, env=env)
        manager.start()
        try:
            yield manager, sim
        finally:
            status = manager.stop()
        assert status == 0, f"the manager ended with status {status}: {manager.log.decode(errors='replace')}"
