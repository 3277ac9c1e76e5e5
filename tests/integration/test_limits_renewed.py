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
from cm.client.stream import LocalStream
from cm.simulation.software import Board as SimBoard

MIB = 1 << 20


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
        limited.reload(leases_each=1)
        assert len(board.status.leases) == 2
        assert refused(board) == "too_many_leases"
        limited.reload(leases_each=3)
        assert refused(board) == ""


def test_no_signal_is_needed(limited: Limited, board: cm.Board) -> None:
    with board.lease("registers:focus", exclusive=False):
        limited.write(leases=1)
        until(lambda: refused(board) == "too_many_leases", 60)


def test_the_slots_of_a_running_stream_follow_the_settings(limited: Limited, board: cm.Board) -> None:
    with board.stream("camera", depth=8, timeout=60) as first:
        first.read()
        limited.reload(slots_each=8)
        with pytest.raises(RequestBusy, match="one process gets 8"):
            board.stream("camera", depth=1, timeout=60).read()
        limited.reload(slots_each=10)
        with board.stream("camera", depth=8, timeout=60) as second:
            assert isinstance(second, LocalStream)
            assert (second.read(), second.geometry)[1].depth == 2  # type: ignore[union-attr]
            assert first.read().sequence >= 0


def test_memory_for_masters_is_limited_per_process_and_reported(limited: Limited, board: cm.Board) -> None:
    limited.reload(memory_each_mib=2, memory_mib=3)
    kept = board.allocate(2 * MIB)
    with pytest.raises(RequestBusy, match=r"2 MiB for one process \(limits.memory_each_mib\); pid \d+"):
        board.allocate(1)
    (mine,) = [client for client in board.clients() if client.memory_bytes]
    assert (mine.name.split()[:2], mine.memory_bytes) == (["pid", str(os.getpid())], 2 * MIB)
    limited.reload(memory_each_mib=8, memory_mib=3)
    with pytest.raises(RequestBusy, match=r"3 MiB together; 2097152 bytes are taken \(pid \d+"):
        board.allocate(2 * MIB)
    kept.free()
    until(lambda: not any(client.memory_bytes for client in board.clients()), 60)


def test_allocations_are_counted_however_small(limited: Limited, board: cm.Board) -> None:
    kept = [board.allocate(1) for _ in range(64)]
    with pytest.raises(RequestBusy, match="has 64 pieces of memory for masters in the PL"):
        board.allocate(1)
    kept.clear()
    until(lambda: not any(client.memory_bytes for client in board.clients()), 60)


def test_uploads_and_quotas_are_those_of_the_file(limited: Limited, board: cm.Board, tmp_path: Path) -> None:
    schema = tmp_path / "mine.yaml"
    schema.write_text("config: {name: mine, modules: {m: {}}, modes: {m: {modules: [m]}}}\n", encoding="utf-8")
    limited.reload(provisioned_each_mib=0)
    with pytest.raises(RequestBusy) as caught:
        board.provision(schema)
    assert caught.value.code == "quota"
    limited.reload(upload_mib=1)
    with pytest.raises(RequestBusy, match=r"limits\.upload_mib"):
        board.write("camera", bytes(5 * MIB))


def test_settings_that_need_a_restart_are_reported(limited: Limited) -> None:
    limited.reload(message_mib=4)
    assert b"limits.message_mib has changed; it counts after a restart" in limited.log()


def test_a_wrong_limit_leaves_all_as_it_was(limited: Limited, board: cm.Board) -> None:
    limited.write(leases_each="-3")
    limited.signal()
    until(lambda: b"not reloaded" in limited.log(), 60)
    assert refused(board) == ""
