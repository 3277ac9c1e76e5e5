# SPDX-License-Identifier: Apache-2.0
"""Limits that change while a manager serves: they apply from then on, and nobody loses what it has."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import CAMERA, Manager, short_folder, until

import cm
from cm.client.errors import RequestBusy
from cm.simulation.software import Board as SimBoard


class Limited:
    """A manager whose limits a test changes."""

    def __init__(self, folder: Path, board: Path) -> None:
        self._settings = folder / "cm.yaml"
        self._folder = folder
        self.write()
        arguments = ("--settings", str(self._settings), "--config", str(CAMERA), "--root", str(board))
        self.manager = Manager(folder / "run", *arguments, service=True).start()
        with self.manager.connected() as connected:
            connected.load("camera", "default")

    def write(self, **limits: object) -> None:
        """Write other limits to the file."""
        said = ", ".join(f"{name}: {value}" for name, value in limits.items())
        new = self._folder / "new.yaml"
        new.write_text(f"state_dir: {self._folder}/state\nlog: info\nlimits: {{{said}}}\n", encoding="utf-8")
        new.replace(self._settings)

    def reload(self, **limits: object) -> None:
        """Write other limits and tell the manager."""
        self.write(**limits)
        told = self.log().count(b"reloaded;")
        self.signal()
        until(lambda: self.log().count(b"reloaded;") > told, 60)

    def signal(self) -> None:
        """As `systemctl reload` does."""
        assert self.manager.process is not None
        os.kill(self.manager.process.pid, signal.SIGHUP)

    def log(self) -> bytes:
        """Its log so far."""
        assert self.manager.process is not None
        assert self.manager.process.stderr is not None
        os.set_blocking(self.manager.process.stderr.fileno(), False)
        with contextlib.suppress(BlockingIOError):
            while piece := os.read(self.manager.process.stderr.fileno(), 65536):
                self.manager.log += piece
        return self.manager.log


@pytest.fixture(scope="module")
def limited() -> Iterator[Limited]:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        made = Limited(folder, sim.root)
        yield made
        made.manager.stop()


@pytest.fixture
def board(limited: Limited) -> Iterator[cm.Board]:
    limited.reload()
    with limited.manager.connected() as connected:
        yield connected


def refused(board: cm.Board, scope: str = "registers:focus") -> str:
    try:
        with board.lease(scope, exclusive=False):
            return ""
    except RequestBusy as error:
        return error.code


def test_leases_are_as_many_as_the_file_says_now_and_held_ones_stay(limited: Limited, board: cm.Board) -> None:
    with board.lease("registers:focus", exclusive=False), board.lease("registers:zoom", exclusive=False):
        limited.reload(leases=8)
        assert len(board.status.leases) == 2
        assert refused(board) == "too_many_leases"
        limited.reload(leases=24)
        assert refused(board) == ""


def test_no_signal_is_needed(limited: Limited, board: cm.Board) -> None:
    with board.lease("registers:focus", exclusive=False):
        limited.write(leases=1)
        until(lambda: refused(board) == "too_many_leases", 60)


def test_settings_that_need_a_restart_are_reported(limited: Limited) -> None:
    limited.reload(message_mib=4)
    assert b"limits.message_mib has changed; it counts after a restart" in limited.log()


def test_a_wrong_limit_leaves_all_as_it_was(limited: Limited, board: cm.Board) -> None:
    limited.write(leases="-3")
    limited.signal()
    until(lambda: b"not reloaded" in limited.log(), 60)
    assert refused(board) == ""
