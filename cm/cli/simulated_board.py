# SPDX-License-Identifier: Apache-2.0
"""The simulated board that ``cm serve --sim`` starts, or takes over from a manager that was killed."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import threading
from collections.abc import Iterator
from pathlib import Path

from cm.device import Root
from cm.server.private_folders import FolderLock, own_folder
from cm.simulation.software.errors import SimError
from cm.simulation.software.process.child import Board

_START_TIMEOUT = 300.0  # seconds: the first time, a design's HDL is compiled
_LOG = logging.getLogger("cm")
_LOOK = 0.5  # seconds between two checks whether it runs
_PATIENCE = 1.0  # seconds that it stays down: Ctrl-C ends both at once
_STARTS = 100  # of a board that keeps ending
_LINGER = "30"  # seconds that a board without a manager keeps its state


@contextlib.contextmanager
def simulated_board(
    runtime: Path, root: Path, configs: list[Path], arguments: list[str], program: str = "cm.simulation.software"
) -> Iterator[Root]:
    """A board under `root` while the context lasts; `program` is the module that serves it.

    A simulator whose manager was killed keeps its state for some seconds, as a board would; `Board`
    takes it over if it was started with the same arguments.
    """
    own_folder(runtime)
    _refuse_where_served(runtime)
    with (
        Board(
            configs, root=root, arguments=["--linger", _LINGER, *arguments], program=program, timeout=_START_TIMEOUT
        ) as board,
        _kept_running(board),
    ):
        yield Root.of(board.root)


@contextlib.contextmanager
def _kept_running(board: Board) -> Iterator[None]:
    """Start a board again that ends while the context lasts; the manager then finds out what it holds."""
    over = threading.Event()
    keeper = threading.Thread(target=_keep, args=(board, over), name="cm-board-keeper", daemon=True)
    keeper.start()
    try:
        yield
    finally:
        over.set()
        keeper.join()


def _keep(board: Board, over: threading.Event) -> None:
    for start in range(_STARTS + 1):
        while board.alive:
            if over.wait(_LOOK):
                return
        if start == _STARTS:
            break
        if over.wait(_PATIENCE):
            return
        _LOG.error("the simulated board has ended; it is started again, and holds nothing")
        try:
            board.restart()
        except SimError as error:
            _LOG.error("the simulated board cannot be started again: %s", error)
            return
    _LOG.error("the simulated board has ended %d times; it is not started again", _STARTS + 1)


def _refuse_where_served(runtime: Path) -> None:
    """Say that a manager serves the folder already, before its board is found to be in use.

    The lock proper is taken by the daemon, whose modules are not imported yet.
    """
    try:
        with (runtime / "lock").open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (BlockingIOError, NotADirectoryError):
        FolderLock(runtime).release()  # raises, naming the holder, or what is no folder
    except OSError:
        return  # no manager has ever served there, or the daemon will report the error


def schema_of_build(build: Path, runtime: Path, kind: str) -> Path:
    """The runtime schema of a build schema, written where the simulated board's manager finds it again.

    For bits, the one that `cm build collect` has made, unchanged.
    """
    if kind == "bits":
        from cm.simulation.bits.main import collected

        folder = collected(build)
        return folder / f"{folder.name}.yaml"
    from cm.simulation.rtl.write_runtime_schema import written

    return written(build, runtime / "schemas")
