# SPDX-License-Identifier: Apache-2.0
"""Processes may be killed at any instant: the others live, and a restart needs no cleaning up."""

from __future__ import annotations

import asyncio
import os
import resource
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest
from manager_process import Manager, environment, until

import cm
import cm.aio
from cm import child
from cm.client.errors import ConnectionLost, NoAnswer, RequestFailed
from cm.errors import CmError, Timeout
from cm.simulation.software import Board as SimBoard

Own = tuple[Manager, SimBoard]


def test_a_killed_manager_finds_what_the_hardware_holds(own: Own) -> None:
    manager, sim = own
    with manager.connected() as board:
        board.load("camera", "edge_detection")
        board.registers["focus"] = 2
    loads = sim.control.state()["loads"]
    manager.kill()
    manager.start()
    with manager.connected() as again:
        assert (again.status.config_name, again.mode) == ("camera", "edge_detection")
        assert again.registers["focus"] == 2
    assert sim.control.state()["loads"] == loads


def test_a_request_to_a_killed_manager_fails_at_once(own: Own) -> None:
    manager, _ = own
    assert manager.process is not None
    with manager.connected() as board:
        os.kill(manager.process.pid, signal.SIGSTOP)  # so that the request is pending when it dies
        killer = threading.Timer(0.2, lambda: manager.process and manager.process.kill())
        killer.start()
        with pytest.raises((ConnectionLost, NoAnswer)):
            board.load("camera", "edge_detection", timeout=5)
        killer.join()
    manager._reap()
    manager.start()


def test_that_the_manager_was_killed_is_known_at_once_however_long_a_request_may_take(own: Own) -> None:
    manager, _ = own
    with manager.connected() as board:
        manager.kill()
        begun = time.monotonic()
        for request in (lambda: board.check_region("prr0"), lambda: board.load("camera", "default")):
            with pytest.raises((ConnectionLost, NoAnswer)):
                request()
        with pytest.raises(NoAnswer, match="nobody serves that socket any more, the manager was killed; start it"):
            board.set_mode("default")  # which may take for ever
        assert time.monotonic() - begun < 30, "a check may take 60 s"

    async def asynchronous() -> None:
        waiting = cm.aio.Board(manager.runtime)
        with pytest.raises(NoAnswer, match="the manager was killed"):
            await waiting.set_mode("default")
        await waiting.close()

    asyncio.run(asynchronous())
    manager.start()


def test_a_wait_for_an_interrupt_beside_a_stopped_manager_ends_in_its_time(own: Own) -> None:
    manager, _ = own
    with manager.connected() as board:
        board.load("camera", "loopback")
        os.kill(manager.pid, signal.SIGSTOP)
        try:
            begun = time.monotonic()
            with pytest.raises(Timeout):
                board.interrupts["loop_done"].wait(timeout=1)
            assert time.monotonic() - begun < 4, "other answers are waited for for 5 s and more"
        finally:
            os.kill(manager.pid, signal.SIGCONT)


def test_going_to_the_mode_that_is_loaded_asks_the_board_whether_it_is_there(own: Own) -> None:
    """Nothing needs to be done for such a change, so nothing else would notice."""
    manager, sim = own
    with manager.connected() as board:
        board.load("camera", "default")
        before = board.status.last_change
        assert board.load("camera", "default") >= 0
        sim.kill()
        for _ in range(2):
            with pytest.raises(RequestFailed, match="has gone, or nothing serves it") as caught:
                board.load("camera", "default")
            assert caught.value.code == "device_gone"
        status = board.status
        assert (status.last_change, status.pr_mode.value) == (before + 3, "error")
        sim.restart()
        until(lambda: board.status.config_name == "")
        board.load("camera", "default")
        assert board.read("camera", timeout=60).shape == (480, 640)


def test_a_second_manager_of_the_same_board_is_refused_and_learns_who_holds_it(own: tuple[Manager, SimBoard]) -> None:
    first, _ = own
    assert first.stop() == 0
    first.start()  # what it holds is the board that there is now: other tests have killed those before
    assert first.process is not None
    second = Manager(first.runtime.parent / "other", *first.arguments)
    with pytest.raises(AssertionError, match=rf"pid {first.process.pid}\) holds the board below"):
        second.start()
    second.stop()
    first.kill()
    second.start()  # the lock ended with its holder
    second.stop()
    first.start()


def test_serve_sim_takes_over_the_board_that_a_killed_manager_left(runtime) -> None:  # type: ignore[no-untyped-def]
    first = Manager(runtime / "run", "--sim").start()
    with first.connected() as board:
        until(lambda: board.mode == "default")
        board.mode = "edge_detection"
    first.kill()
    second = Manager(runtime / "run", "--sim").start()
    with second.connected() as board:
        assert board.mode == "edge_detection"
    assert second.stop() == 0
    assert sorted(p.name for p in (runtime / "run").iterdir()) == ["lock", "state"]


def test_serve_sim_starts_a_board_again_that_was_killed(runtime) -> None:  # type: ignore[no-untyped-def]
    served = Manager(runtime / "run", "--sim").start()
    try:
        assert served.process is not None
        tasks = Path(f"/proc/{served.process.pid}/task")
        with served.connected() as board:
            until(lambda: board.mode == "default")
            for pid in {pid for task in tasks.iterdir() for pid in (task / "children").read_text("ascii").split()}:
                os.kill(int(pid), signal.SIGKILL)
            until(lambda: board.status.last_error is not None, 60)
            until(lambda: _works(board), 60)
    finally:
        assert served.stop() == 0


def _works(board: cm.Board) -> bool:
    try:
        board.load("camera", "edge_detection")
        return board.read("camera", timeout=60).shape == (480, 640)
    except CmError:
        return False


def _used(pid: int) -> float:
    """Seconds of processor time of a process, without its children."""
    after_name = Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()
    return (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")


def _reaped() -> float:
    """The same of all processes that this one has waited for, and theirs."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def test_told_to_end_manager_and_board_have_little_left_to_do(runtime) -> None:  # type: ignore[no-untyped-def]
    """To take both interpreters apart took longer than all the rest; on a busy machine 1.7 s."""
    manager = Manager(runtime / "run", "--sim").start()
    with manager.connected() as board:
        until(lambda: board.mode == "default" and not board.status.fpga_busy)
    tasks = Path(f"/proc/{manager.pid}/task").iterdir()
    boards = [int(pid) for task in tasks for pid in (task / "children").read_text("ascii").split()]
    assert boards
    before, used = _reaped(), sum(map(_used, (manager.pid, *boards)))
    assert manager.stop() == 0
    assert (_reaped() - before - used) * 4 < used  # which is what it took to start; the clock ticks 100 times a second


def test_a_manager_that_is_stopped_while_its_board_starts_stops_the_board_too(runtime) -> None:  # type: ignore[no-untyped-def]
    command = child.command("cm.cli.main", "serve", "--sim", "--runtime-dir", str(runtime / "run"))
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment()) as served:
        until((runtime / "run/board").exists)
        served.terminate()
        served.communicate(timeout=120)  # the board has the same output open, too
        assert served.returncode == 0
    assert not (runtime / "run/board").exists()
