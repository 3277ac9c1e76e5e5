# SPDX-License-Identifier: Apache-2.0
"""The simulated board that ``cm serve --sim`` brings along, or takes over from a manager that was killed."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import signal
from collections.abc import Iterator
from pathlib import Path

from cm.device import Root
from cm.errors import Timeout
from cm.sim.process import Board
from cm.sim.root import LOCK

_ARGUMENTS = "board.json"
_LINGER = "30"  # seconds that a board without a manager keeps its state
_STOP_TIMEOUT_MS = 10_000


@contextlib.contextmanager
def simulated_board(runtime: Path, root: Path, configs: list[Path], arguments: list[str]) -> Iterator[Root]:
    """A board under `root` while the context lasts.

    A simulator whose manager was killed keeps its state for some seconds, as a board would. If it was
    started with the same arguments it is taken over, so that the manager finds what the hardware
    holds; else it is stopped first.
    """
    runtime.mkdir(mode=0o750, parents=True, exist_ok=True)
    wanted = json.dumps([*map(str, configs), *arguments])
    record = runtime / _ARGUMENTS
    pid = _holder(root)
    if pid and record.exists() and record.read_text(encoding="utf-8") == wanted:
        try:
            yield Root.of(root)
        finally:
            _stop(pid)
            record.unlink(missing_ok=True)
        return
    if pid:
        _stop(pid)
    with Board(configs, root=root, arguments=["--linger", _LINGER, *arguments]) as board:
        record.write_text(wanted, encoding="utf-8")
        try:
            yield Root.of(board.root)
        finally:
            record.unlink(missing_ok=True)


def _holder(root: Path) -> int:
    """The process that serves `root`, 0 if none does."""
    try:
        fd = os.open(root / LOCK, os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return 0
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return int(os.read(fd, 32) or b"0")
    finally:
        os.close(fd)
    return 0


def _stop(pid: int) -> None:
    """End a process that may be nobody's child; returns when it has gone. Raises Timeout."""
    try:
        fd = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
        poller = select.poll()
        poller.register(fd, select.POLLIN)
        if not poller.poll(_STOP_TIMEOUT_MS):
            raise Timeout(f"the simulator of an earlier run (process {pid}) does not end; kill it")
    finally:
        os.close(fd)
