# SPDX-License-Identifier: Apache-2.0
"""A configuration manager to measure: ``cm serve`` as a process."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cm import child
from cm.client.board import Board
from cm.errors import CmError, Timeout
from cm.tools.bench.run import Run

PATIENCE = 60.0  # seconds, on a loaded machine


@dataclass(frozen=True, slots=True)
class Served:
    """A manager that serves; `seconds` passed from its start to its first reply, `cpu` is what it used of them."""

    process: subprocess.Popen[bytes]
    runtime_dir: Path
    seconds: float
    cpu: float

    @property
    def pid(self) -> int:
        """Of the manager."""
        return self.process.pid

    def connect(self) -> Board:
        """A client; the caller closes it."""
        return Board(runtime_dir=self.runtime_dir, timeout=PATIENCE)


@contextmanager
def serve(run: Run, *arguments: str, sim: bool = True) -> Iterator[Served]:
    """A manager while the context lasts; it has answered once."""
    folder = run.place("s")
    words = child.command("cm", "serve", *(["--sim"] if sim else []), "--runtime-dir", str(folder))
    words += ["--state-dir", str(folder / "state"), *arguments]
    started = time.monotonic()
    process = subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=environment(run)
    )
    try:
        _await_reply(process, folder)
        seconds = time.monotonic() - started
        yield Served(process, folder, seconds, cpu_seconds(process.pid))
    finally:
        process.terminate()
        process.communicate()


def environment(run: Run) -> dict[str, str]:
    """Our environment, with bytecode kept in the run's folder, as an installed package has its own."""
    kept = {name: value for name, value in child.environment().items() if name != "PYTHONDONTWRITEBYTECODE"}
    # A busy machine makes the simulated board slow, and a slow one is no reason to fail.
    return {"CM_SIM_TIMEOUT": "60", **kept, "PYTHONPYCACHEPREFIX": str(run.bytecode)}


def _await_reply(process: subprocess.Popen[bytes], folder: Path) -> None:
    ready, said = child.said_until(process, b"ready at", PATIENCE)
    if not ready and process.poll() is None:
        raise Timeout(f"cm serve did not say within {PATIENCE:.0f} s that it is ready: {said.decode(errors='replace')}")
    if not ready:
        raise CmError(f"cm serve ended with status {process.returncode}: {said.decode(errors='replace').strip()}")
    with Board(runtime_dir=folder, timeout=PATIENCE) as board:
        _ = board.status


def settle(board: Board) -> None:
    """Wait until the manager has entered its mode."""
    for status in board.watch(timeout=PATIENCE):
        if status.mode and not status.fpga_busy:
            return
        if status.last_error is not None and not status.fpga_busy:
            raise CmError(f"the manager did not enter its mode: {status.last_error.message}")


def cpu_seconds(pid: int) -> float:
    """Processor time of a process so far, all its threads (schedstat: ns, counted and not sampled)."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        total += int((task / "schedstat").read_text(encoding="ascii").split()[0])
    return total / 1e9


def cpu_percent(pid: int, work: Callable[[], object]) -> float:
    """Percent of one CPU that a process uses while `work` is done here."""
    before, started = cpu_seconds(pid), time.monotonic()
    work()
    return 100 * (cpu_seconds(pid) - before) / (time.monotonic() - started)


def resident_mib(pid: int) -> float:
    """Resident memory of a process (RSS), MiB: with every page of a library that it has touched, whoever shares it."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def proportional_mib(pid: int) -> float:
    """Its share of resident memory (PSS), MiB: a page that several processes have counts for each in part."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024
