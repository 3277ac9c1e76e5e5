# SPDX-License-Identifier: Apache-2.0
"""What a client was told that a register holds, it holds after the manager was killed, too."""

from __future__ import annotations

import errno
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest
from manager_support import Rig, camera, killed_at, make_rig, rig

from cm.errors import CmError
from cm.manager.access.register_windows import WindowRequest
from cm.manager.errors import RecordFailed
from cm.schema.model import Access, Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, RegWrite

LED = "led"


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with SimBoard(arguments=["--icap-rate", "0"]) as board:
        yield board


def write(made: Rig, name: str, value: int) -> None:
    made.manager.write_registers((RegWrite(name, value),))


def read(made: Rig, name: str) -> int:
    return made.manager.registers.read((name,)).values[0].value


def dies(work: Callable[[], None]) -> None:
    """Do it in a child process that is killed at its end."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(pid, 0)


def test_a_value_that_was_not_recorded_yet_is_known_again(sim: SimBoard, tmp_path: Path) -> None:
    def work() -> None:
        made = make_rig(sim.root, tmp_path)
        made.manager.start()
        made.go("default")
        write(made, LED, 3)
        write(made, "focus", 4)
        made.manager.flush()
        write(made, LED, 9)
        write(made, "focus", 7)

    dies(work)
    with rig(sim.root, tmp_path) as again:
        again.manager.wait_idle()
        assert (read(again, LED), read(again, "focus")) == (9, 7)
        assert (again.manager.state.values[LED], again.manager.state.values["focus"]) == (9, 7)


@pytest.mark.parametrize("before", [3, None], ids=["recorded before", "never recorded"])
def test_a_value_confirmed_during_a_change_survives_whenever_the_manager_dies_in_it(
    sim: SimBoard, tmp_path: Path, before: int | None
) -> None:
    """An older one came back once in eighty kills: the way back took the record's."""

    def work(number: int, told: int) -> None:
        made = make_rig(sim.root, tmp_path / str(number))
        made.manager.start()
        made.go("default")
        if before is not None:
            write(made, LED, before)
            made.manager.flush()

        def confirmed() -> None:
            with suppress(CmError):
                write(made, LED, 9)
                os.write(told, b"y")

        def blow(_: str) -> Exception:
            client = threading.Thread(target=confirmed)  # where the operation holds a lock, nothing is confirmed
            client.start()
            client.join(0.3)
            os.kill(os.getpid(), signal.SIGKILL)
            raise AssertionError

        made.fault.make = blow
        made.arm(number)
        made.manager.submit(ChangeMode("camera", "edge_detection")).wait(30.0)
        os.write(told, b"e")

    for number in range(0 if before is None else 2, 200, 4):  # together, every second operation
        (tmp_path / str(number)).mkdir()
        heard, told = os.pipe()
        dies(lambda number=number, told=told: work(number, told))  # type: ignore[misc]
        os.close(told)
        said = os.read(heard, 9)
        os.close(heard)
        with rig(sim.root, tmp_path / str(number)) as again:
            again.manager.wait_idle()
            if said == b"y":
                assert read(again, LED) == 9, f"killed at operation {number}"
            assert again.go("default") is None
            write(again, LED, 1)
        if said == b"e":
            assert number > 4
            break
    else:
        raise AssertionError("the change never came to its end")


def test_a_start_that_undoes_a_change_is_busy_from_its_beginning_and_keeps_what_is_written_meanwhile(
    sim: SimBoard, tmp_path: Path
) -> None:
    with rig(sim.root, tmp_path) as made:
        assert made.go("default") is None
        write(made, LED, 3)
    assert killed_at(sim.root, tmp_path, (camera(),), ("camera", "edge_detection"), 24)
    again = make_rig(sim.root, tmp_path)
    again.manager.reconcile()  # a start, as far as the worker's thread
    assert again.manager.status().fpga_busy
    write(again, LED, 9)
    again.manager._worker.start()
    again.manager.wait_idle()
    assert (again.manager.state.mode, read(again, LED)) == ("default", 9)
    again.close()


def write_only() -> Config:
    config = camera()
    registers = {n: replace(r, access=Access.WO) if n == "scratch" else r for n, r in config.registers.items()}
    return replace(config, registers=MappingProxyType(registers))


def test_what_cannot_be_read_back_is_recorded_before_its_write_is_confirmed(sim: SimBoard, tmp_path: Path) -> None:
    with rig(sim.root, tmp_path, write_only()) as made:
        assert made.go("default") is None
        write(made, "scratch", 5)
        record = made.journal.read()
        assert record is not None
        assert record.state.values["scratch"] == 5
        write(made, LED, 6)  # which can be read back
        assert made.journal.read() == record
        made.fault.watch = no_record
        with pytest.raises(RecordFailed, match="scratch was written, but is not known after a restart"):
            write(made, "scratch", 7)
        write(made, LED, 8)


def no_record(name: str) -> None:
    if name == "journal.write":
        raise OSError(errno.EIO, "injected")


def taken(made: Rig, name: str, value: int) -> bool:
    """Write; whether that was confirmed, and not refused as a restart would undo it."""
    try:
        write(made, name, value)
    except RecordFailed as error:
        if "nothing was written, as a restart would undo it: the state record could not be" not in str(error):
            raise
        return False
    return True


def test_a_write_that_the_next_start_would_undo_is_refused(sim: SimBoard, tmp_path: Path) -> None:
    """Where the disk failed in the middle of a change, that start goes by a record from before it was undone."""
    refused, kept = 0, 0
    for number in range(40):
        with rig(sim.root, tmp_path / str(number)) as made:
            assert made.go("default") is None
            write(made, "focus", 4)
            writes = iter(range(1000))
            made.fault.watch = lambda name, w=writes, n=number: (  # type: ignore[misc]
                no_record(name) if name == "journal.write" and next(w) >= n else None
            )
            ended = made.go("edge_detection")
            told = {name: value for name, value in (("focus", 7), (LED, 8), ("scratch", 9)) if taken(made, name, value)}
            refused += 3 - len(told)
            if not told:
                with pytest.raises(RecordFailed):
                    made.manager.windows.lend(WindowRequest("prr0", True, False, "", "a test", 1), None, print)  # type: ignore[arg-type]
                with pytest.raises(RecordFailed):
                    made.manager.memories.begin_write("scratchpad", 0, bytes(4), "")
            now = told or {name: read(made, name) for name in ("focus", LED, "scratch")}
            kept += len(told)
            mode = made.manager.state.mode
        with rig(sim.root, tmp_path / str(number)) as again:
            again.manager.wait_idle()
            assert {name: read(again, name) for name in now} == now, f"no record from number {number} on: {again.notes}"
            assert again.manager.state.mode == mode
        if ended is None:
            break
    assert refused > 3 < kept


def test_a_disk_that_is_whole_again_takes_the_record_with_the_next_write(sim: SimBoard, tmp_path: Path) -> None:
    with rig(sim.root, tmp_path) as made:
        assert made.go("default") is None
        writes = iter(range(1000))
        made.fault.watch = lambda name: no_record(name) if name == "journal.write" and next(writes) >= 4 else None
        assert made.go("edge_detection") is not None
        with pytest.raises(RecordFailed):
            write(made, "focus", 6)
        made.fault.watch = lambda _: None
        write(made, "focus", 7)
        record = made.journal.read()
        assert record is not None
        assert record.pending is None
    with rig(sim.root, tmp_path) as again:
        again.manager.wait_idle()
        assert (again.notes, read(again, "focus")) == ((), 7)
