# SPDX-License-Identifier: Apache-2.0
"""Registers that a client has mapped: used by name, taken back before a change, gone with their client."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from manager_process import REPOSITORY, Manager, environment, stalled, until

import cm
import cm.aio
from cm import device
from cm.cli.main import main
from cm.client.errors import (
    BoardClosed,
    RequestBusy,
    RequestFailed,
    WindowRevoked,
)
from cm.errors import Timeout
from cm.server.window_clients import EACH
from cm.simulation.software import Board as SimBoard
from cm.wire import plane_packets as packets

IDENTITY = {"edge": 0xCA3E0002}


@pytest.fixture
def edge(board: cm.Board) -> cm.Board:
    """The board in a mode with the module `edge`."""
    board.mode = "edge_detection"
    return board


def windows(board: cm.Board) -> list[str]:
    return [window.module for window in board.status.windows]


def code(act: Callable[[], Any]) -> str:
    with pytest.raises(RequestFailed) as told:
        act()
    return told.value.code


# ---- by name ---------------------------------------------------------------------------


def test_what_is_written_in_a_window_is_what_requests_read(edge: cm.Board) -> None:
    with edge.registers.window("edge") as regs:
        regs.focus = 2
        assert (regs.focus, regs["focus"], edge.registers["focus"]) == (2, 2, 2)
        edge.registers["focus"] = 3
        assert regs.focus == 3
        assert regs.ident == IDENTITY["edge"]
        assert set(regs) >= {"focus", "ident", "threshold"}


def test_a_region_is_a_window_of_whatever_it_holds(edge: cm.Board) -> None:
    with edge.registers.window("prr0", write=False) as regs:
        assert (regs.module, regs.region) == ("edge", "prr0")
        assert regs.threshold == 0


def test_the_asyncio_client_has_the_same_windows(edge: cm.Board, manager: Manager) -> None:
    async def use() -> int:
        async with await cm.aio.connect(runtime_dir=manager.runtime, timeout=60) as board:
            with await board.registers.window("edge") as regs:
                regs.focus = 6
                return int(regs.focus)

    assert asyncio.run(use()) == 6
    assert edge.registers["focus"] == 6


# ---- taken back ----------------------------------------------------------------------


def test_a_change_of_mode_takes_a_window_back(edge: cm.Board) -> None:
    with edge.registers.window("edge") as regs:
        edge.mode = "default"
        for access in (lambda: regs.focus, lambda: setattr(regs, "focus", 1), lambda: regs.array("focus", 2)):
            with pytest.raises(WindowRevoked) as told:
                access()
            assert (told.value.config_name, told.value.mode) == ("camera", "default")
            why = "the manager took it back; the board goes to camera/default"
            assert str(told.value) == f"the window of edge is gone: {why}"
        assert repr(regs) == "<window of edge, revoked>"
        assert regs.revoked
        assert windows(edge) == []


def test_a_change_that_does_not_touch_the_region_leaves_the_window(edge: cm.Board) -> None:
    with edge.registers.window("edge") as regs:
        edge.load("camera", "edge_detection")
        assert regs.ident == IDENTITY["edge"]


def test_nobody_reads_another_modules_register(edge: cm.Board, manager: Manager) -> None:
    over = threading.Event()

    def change() -> None:
        with manager.connected() as other:
            for mode in ("default", "edge_detection", "colorise", "edge_detection"):
                other.mode = mode
        over.set()

    changes = threading.Thread(target=change)
    found = set()
    with edge.registers.window("edge", wait=True, timeout=60) as regs:
        changes.start()
        while not over.is_set():
            found.add(regs.ident)
    changes.join()
    assert found == {IDENTITY["edge"]}


def test_a_window_that_waits_goes_on_when_its_module_is_back(edge: cm.Board) -> None:
    with edge.registers.window("prr0", wait=True) as regs:
        edge.mode = "default"
        edge.mode = "edge_detection"
        regs.focus = 7
        assert (regs.focus, regs.ident, edge.registers["focus"]) == (7, IDENTITY["edge"], 7)


def test_waiting_for_a_module_ends_in_time(board: cm.Board) -> None:
    for seconds in (0.05, 0):
        with pytest.raises(Timeout, match=rf"within {seconds} s$"):
            board.registers.window("edge", wait=True, timeout=seconds)
    assert windows(board) == []


def test_what_a_window_wrote_is_known_when_it_has_ended(edge: cm.Board) -> None:
    with edge.registers.events("focus", timeout=60) as events:
        with edge.registers.window("edge") as regs:
            regs.focus = 11
        told = next(iter(events))
    assert [(value.name, value.value) for value in told.values] == [("focus", 11)]


def test_a_change_that_fails_restores_what_a_window_wrote(edge: cm.Board, shared: tuple[Manager, SimBoard]) -> None:
    with edge.registers.window("edge") as regs:
        regs.threshold = 99
        shared[1].control.inject("icap_crc", count=1)
        with pytest.raises(RequestFailed):
            edge.mode = "default"
    assert (edge.mode, edge.registers["threshold"]) == ("edge_detection", 99)


# ---- who may ---------------------------------------------------------------------------


def test_a_lease_of_another_keeps_writers_off_and_takes_their_windows(edge: cm.Board, manager: Manager) -> None:
    with manager.connected() as other:
        with other.lease("region:prr0"):
            assert code(lambda: edge.registers.window("edge")) == "held_by"
            with edge.registers.window("edge", write=False) as regs, other.registers.window("edge") as theirs:
                assert (regs.ident, theirs.ident) == (IDENTITY["edge"],) * 2
        with edge.registers.window("edge") as regs, other.lease("registers:focus"), pytest.raises(WindowRevoked):
            _ = regs.focus


def test_a_lease_of_ones_own_is_taken_before_the_window(edge: cm.Board) -> None:
    with edge.registers.window("edge") as regs, edge.lease("region:prr0"):
        with pytest.raises(WindowRevoked, match="a lease keeps it off, your own if it was taken later"):
            _ = regs.focus
        with edge.registers.window("edge") as another:
            assert another.ident == IDENTITY["edge"]


def test_a_window_that_waits_comes_back_with_a_lease_of_its_own_board(edge: cm.Board) -> None:
    with edge.registers.window("edge", wait=True, timeout=20) as regs, edge.lease("region:prr0", seconds=600):
        assert regs.ident == IDENTITY["edge"]


def test_an_exclusive_window_keeps_others_off_until_it_ends(edge: cm.Board, manager: Manager) -> None:
    with manager.connected() as other:
        with edge.registers.window("edge", exclusive=True) as regs:
            edge.registers["focus"] = 4  # the holder's own requests pass
            assert regs.focus == 4
            assert [lease.scope for lease in other.status.leases] == ["region:prr0"]
            assert code(lambda: other.registers.write({"focus": 1})) == "held_by"
            assert code(lambda: other.registers.window("edge")) == "held_by"
            with pytest.raises(RequestBusy):
                other.mode = "default"
        until(lambda: not other.status.leases)
        other.registers["focus"] = 1
        with other.registers.window("edge"):
            assert code(lambda: edge.registers.window("edge", exclusive=True)) == "held_by"


def test_status_and_lease_list_show_who_has_a_window(
    edge: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    with edge.registers.window("edge"):
        for command in (["status"], ["lease", "list"]):
            assert main([*command, "--runtime-dir", str(manager.runtime)]) == 0
            assert f"pid {os.getpid()}" in capsys.readouterr().out
        assert main(["status", "--json", "--runtime-dir", str(manager.runtime)]) == 0
        shown = json.loads(capsys.readouterr().out)["windows"]
    assert [(x["region"], x["module"], x["writes"], x["pid"]) for x in shown] == [("prr0", "edge", True, os.getpid())]
    until(lambda: not edge.status.windows)


# ---- life -------------------------------------------------------------------------------


def test_a_closed_window_says_so(edge: cm.Board) -> None:
    regs = edge.registers.window("edge")
    regs.close()
    regs.close()
    for access in (lambda: regs.focus, lambda: setattr(regs, "focus", 1), lambda: regs.array("focus")):
        with pytest.raises(BoardClosed, match=r"^the window of 'edge' was closed: open another$"):
            access()
    until(lambda: not edge.status.windows)


def test_a_window_ends_with_its_board(edge: cm.Board, manager: Manager) -> None:
    with manager.connected() as other:
        regs = other.registers.window("edge")
    with pytest.raises(BoardClosed):
        _ = regs.focus
    until(lambda: not edge.status.windows)


def test_the_processes_of_a_user_have_so_many(edge: cm.Board, manager: Manager) -> None:
    """Eight processes took all that there are."""
    with ExitStack() as stack:
        for _ in range(EACH // 8):
            board = stack.enter_context(manager.connected())
            for _ in range(8):
                stack.callback(board.registers.window("edge", write=False).close)
        assert code(lambda: edge.registers.window("edge")) == "busy"
    until(lambda: not edge.status.windows)


# ---- attacks -----------------------------------------------------------------------------

CLIENT = """
import os, signal, sys, time
import cm
board = cm.connect(runtime_dir=sys.argv[1], timeout=60)
def say(text):
    print(text, flush=True)
"""


@contextmanager
def client(manager: Manager, text: str) -> Iterator[subprocess.Popen[str]]:
    """A client in a process of its own, that does what `text` says."""
    command = [sys.executable, "-c", CLIENT + text, str(manager.runtime)]
    process = subprocess.Popen(command, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def descriptors(pid: int) -> int:
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))


def test_a_killed_client_leaves_nothing_of_a_thousand_windows(edge: cm.Board, manager: Manager) -> None:
    with edge.registers.window("edge"):
        pass
    until(lambda: not edge.status.windows)
    before = descriptors(manager.pid)
    text = """
for _ in range(992):
    board.registers.window("edge").close()
held = [board.registers.window("edge") for _ in range(8)]
say("held")
time.sleep(600)
"""
    with client(manager, text) as process:
        assert line(process) == "held"
        assert len(windows(edge)) == 8
        process.kill()
        until(lambda: not edge.status.windows)
    until(lambda: descriptors(manager.pid) <= before)
    with edge.registers.window("edge", exclusive=True) as regs:
        assert regs.ident == IDENTITY["edge"]


def test_a_stopped_client_does_not_hold_up_a_change_and_finds_its_window_gone(edge: cm.Board, manager: Manager) -> None:
    text = """
from cm.client.errors import WindowRevoked
regs = board.registers.window("edge")
say("held")
os.kill(os.getpid(), signal.SIGSTOP)
try:
    say(f"read {regs.ident:#x}")
except WindowRevoked as error:
    say(f"revoked {error.mode}")
"""
    with client(manager, text) as process:
        assert line(process) == "held"
        until(lambda: Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")
        edge.mode = "default"
        assert windows(edge) == []
        process.send_signal(signal.SIGCONT)
        assert line(process) == "revoked default"


def test_a_forked_child_has_no_window_and_does_not_end_its_parents(edge: cm.Board) -> None:
    with edge.registers.window("edge") as regs:
        child = os.fork()
        if child == 0:
            status = 1
            try:
                _ = regs.focus
            except BoardClosed:
                status = 0
            finally:
                regs.close()
                os._exit(status)
        assert os.waitpid(child, 0)[1] == 0
        regs.focus = 8
        assert regs.focus == 8
        assert len(windows(edge)) == 1


def raw_window(manager: Manager, name: str) -> tuple[socket.socket, device.MappedWindow]:
    """A window of a client that keeps to no rules: its connection, and the pages."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    connection.settimeout(60)
    connection.connect(str(manager.runtime / packets.SOCKET))
    connection.send(packets.encode_open(packets.Open(name, packets.Purpose.WRITABLE_WINDOW)))
    _, fds, _, _ = socket.recv_fds(connection, packets.PACKET_MAX, 2)
    mapped = device.MappedWindow(fds[0])
    for fd in fds:
        os.close(fd)
    return connection, mapped


def test_a_client_that_keeps_its_pages_has_them_taken(edge: cm.Board, manager: Manager) -> None:
    """It hangs up, and goes on reading."""
    connection, mapped = raw_window(manager, "edge")
    with mapped:
        assert mapped.read(0) == IDENTITY["edge"]
        connection.close()
        until(lambda: mapped.revoked)
        with pytest.raises(device.DeviceRevoked):
            mapped.read(0)


def test_a_client_that_lets_go_of_its_pages_has_no_window(edge: cm.Board, manager: Manager) -> None:
    connection, mapped = raw_window(manager, "edge")
    with connection:
        mapped.close()
        until(lambda: not edge.status.windows)
        assert connection.recv(packets.PACKET_MAX)[2] == packets.REVOKED
        assert connection.recv(packets.PACKET_MAX) == b""


def test_a_client_that_talks_over_its_window_loses_it(edge: cm.Board, manager: Manager) -> None:
    connection, mapped = raw_window(manager, "edge")
    with connection, mapped:
        connection.send(b"\xff" * 4096)
        until(lambda: mapped.revoked)
    until(lambda: not edge.status.windows)


def test_nothing_is_lent_while_the_region_is_changed(edge: cm.Board, shared: tuple[Manager, SimBoard]) -> None:
    with shared[0].connected() as other:
        with stalled(shared[1]):
            change = edge.load_async(mode="default")
            until(lambda: other.status.progress is not None and other.status.progress.step == "load")
            for name in ("edge", "prr0"):
                assert code(lambda name=name: other.registers.window(name)) in ("region_busy", "module_absent")  # type: ignore[misc]
        change.wait()


def test_windows_end_with_the_manager(own: tuple[Manager, SimBoard]) -> None:
    manager, _ = own
    for end in (manager.kill, manager.stop):
        with manager.connected() as board:
            board.load("camera", "edge_detection")
            regs = board.registers.window("edge", exclusive=True)
            assert not end()
            until(lambda regs=regs: regs.revoked)
            with pytest.raises(WindowRevoked, match=r"^the window of edge is gone: the manager has ended$"):
                _ = regs.focus
        manager.start()


def test_the_control_loop_reads_no_other_modules_register(board: cm.Board, manager: Manager) -> None:
    example = REPOSITORY / "examples" / "control_loop.py"
    words = ["--runtime-dir", str(manager.runtime), "--seconds", "0.5", "--changes", "4", "--reads", "20000"]
    done = subprocess.run(
        [sys.executable, str(example), *words], env=environment(), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "reads, 0 of another module" in done.stdout
    assert board.mode == "edge_detection"
