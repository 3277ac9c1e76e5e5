# SPDX-License-Identifier: Apache-2.0
"""What a client was told that a register holds, it holds after the manager was killed, too."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest
from manager_support import Rig, camera, make_rig, rig

from cm.errors import CmError
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
