# SPDX-License-Identifier: Apache-2.0
"""Isolation by a sequence of writes and polls, all of which are done before anything is loaded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from manager_support import Rig, place_of, rig

from cm.device import Root, Uio
from cm.manager.access.register_bus import RegisterBus, drive, is_cut
from cm.manager.errors import VerifyFailed
from cm.schema import dump, load, loads
from cm.schema.model import Config, Decoupler, GpioLine, IsolationStep
from cm.simulation.software import Board as SimBoard

TEXT = """
config:
  name: kria
  type: partial
  device: xc7z020
  regions:
    slot0:
      decoupler:
        base_address: 0x5000
        offset: 0x100
        sequence:
          - {offset: 0x0, cut: 0, couple: 0x01, verify: false}
          - {offset: 0x4, cut: 0, couple: 0x0b}
          - {offset: 0x4, cut: 0, couple: 0x0b, poll: true, timeout: 0.1}
          - {offset: 0x8, cut: 0x20, couple: 0x00, mask: 0x20}
    slot1:
      decoupler: {base_address: 0x5000, offset: 0x108, bit: 6}
  modules:
    a0: {region: slot0}
    b0: {region: slot0}
    a1: {region: slot1}
  modes:
    default: {modules: [a0, a1]}
    other: {modules: [b0]}
"""


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    path = tmp_path_factory.mktemp("kria") / "kria.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return {"kria": load(path)}


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config]) -> Iterator[SimBoard]:
    source = configs["kria"].source
    assert source is not None
    with SimBoard([source], arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        assert started.go("default", config="kria") is None
        yield started


def registers(sim: SimBoard) -> list[int]:
    with Uio.open(0x5000, Root.of(sim.root)) as uio:
        return [uio.read(0x100 + offset) for offset in (0, 4, 8)]


def test_a_region_is_cut_off_by_all_of_the_sequence_before_its_load(made: Rig, sim: SimBoard) -> None:
    seen: list[object] = []

    def watch(name: str) -> None:
        if name == "icap.load":
            regions = sim.control.state()["regions"]
            seen.append((registers(sim), regions["slot0"]["decoupled"], regions["slot1"]["decoupled"]))

    made.arm(-1)
    made.fault.watch = watch
    assert made.go("other", config="kria") is None
    assert seen == [([0, 0, 0x20], True, False)]
    assert registers(sim) == [0x01, 0x0B, 0]
    assert not sim.control.state()["regions"]["slot0"]["decoupled"]


def test_whichever_operation_fails_the_region_is_as_the_status_says(
    made: Rig, sim: SimBoard, configs: dict[str, Config]
) -> None:
    failed = 0
    for number in range(80):
        assert made.go("default", config="kria") is None
        made.arm(number)
        error = made.go("other", config="kria")
        made.fault.at = -1
        assert place_of(made, sim, configs) == ("kria/default" if error else "kria/other"), f"{number}: {error}"
        assert registers(sim) == [0x01, 0x0B, 0]
        if error is None:
            break
        failed += 1
    assert failed > 20


def test_under_persistent_failures_a_region_is_as_the_status_says(
    made: Rig, sim: SimBoard, configs: dict[str, Config]
) -> None:
    ends = set()
    for number in range(0, 60, 2):
        assert made.go("default", config="kria") is None
        made.arm(number, times=10_000)
        error = made.go("other", config="kria")
        made.arm(-1)
        if error is None:
            break
        place_of(made, sim, configs)
        ends.add(made.manager.state.region("slot0").phase.value)
    assert "failed" in ends


def test_a_poll_that_does_not_come_true_loads_nothing(sim: SimBoard, tmp_path: Path) -> None:
    never = "{offset: 0x4, cut: 0x80, couple: 0x0b, mask: 0x80, poll: true, timeout: 0.1}"
    text = TEXT.replace("{offset: 0x4, cut: 0, couple: 0x0b, poll: true, timeout: 0.1}", never)
    assert text != TEXT
    with rig(sim.root, tmp_path, loads(text)) as waiting:
        loads_before = sim.control.state()["loads"]
        error = waiting.go("default", config="kria")
        assert error is not None
        assert error.code == "verify_failed"
        assert "after 0.1 s, not 0x80" in error.message
        assert sim.control.state()["loads"] == loads_before


def test_a_sequence_travels_with_the_schema(configs: dict[str, Config]) -> None:
    again = loads(dump(configs["kria"]))
    assert again.regions["slot0"].decoupler == configs["kria"].regions["slot0"].decoupler


def test_values_that_do_not_fit_the_register_are_refused() -> None:
    text = TEXT.replace("cut: 0, couple: 0x01", "cut: 0, couple: 0x100000001")
    with pytest.raises(ValueError, match="does not fit a register of 32 bits"):
        loads(text)


# ---- accesses, without a board ---------------------------------------------------------------

BIT = Decoupler(0x1000, 4, bit=3)
LOW = replace(BIT, active_high=False)
STEPS = (
    IsolationStep(0, 0xA5, 0x5A, mask=0xF0),
    IsolationStep(4, 2, 1, poll=True, timeout=0.0),
    IsolationStep(8, 7, 0, verify=False),
)
SEQUENCE = Decoupler(0x1000, 4, width=8, sequence=STEPS)
LINE = Decoupler(gpio=GpioLine("chip", "cut"))


class Cells:
    """Registers and a line that hold what is written, but for the bits that are stuck."""

    def __init__(self, cells: dict[int, int], stuck: int = 0) -> None:
        self.cells, self.stuck, self.done = dict(cells), stuck, list[tuple[str, int, int]]()
        self.line: Any = SimpleNamespace(value=0)

    def window(self, address: int, width: int) -> Any:
        return SimpleNamespace(device=self, map=0, offset=address)

    def gpio(self, chip: str, line: object) -> Any:
        assert (chip, line) == ("chip", "cut")
        return self.line

    def read(self, offset: int, width: int, number: int) -> int:
        self.done.append(("read", offset, width))
        return self.cells[offset]

    def write(self, offset: int, value: int, width: int, number: int) -> None:
        self.done.append(("write", offset, value))
        self.cells[offset] = value & ~self.stuck


@pytest.mark.parametrize(
    ("decoupler", "cut", "cells", "done"),
    [
        (BIT, True, {0x1004: 0x10}, [("read", 0x1004, 32), ("write", 0x1004, 0x18), ("read", 0x1004, 32)]),
        (BIT, False, {0x1004: 0x18}, [("read", 0x1004, 32), ("write", 0x1004, 0x10), ("read", 0x1004, 32)]),
        (LOW, True, {0x1004: 0x18}, [("read", 0x1004, 32), ("write", 0x1004, 0x10), ("read", 0x1004, 32)]),
        (LOW, False, {0x1004: 0x10}, [("read", 0x1004, 32), ("write", 0x1004, 0x18), ("read", 0x1004, 32)]),
        (
            SEQUENCE,
            True,
            {0x1004: 0x0C, 0x1008: 2},
            [
                ("read", 0x1004, 8),
                ("write", 0x1004, 0xAC),
                ("read", 0x1004, 8),
                ("read", 0x1008, 8),
                ("write", 0x100C, 7),
            ],
        ),
    ],
)
def test_a_region_is_cut_off_by_its_bits_alone(
    decoupler: Decoupler, cut: bool, cells: dict[int, int], done: list[tuple[str, int, int]]
) -> None:
    board: Any = Cells(cells)
    drive(RegisterBus(board), decoupler, cut)
    assert board.done == done
    assert is_cut(RegisterBus(board), decoupler) is cut


@pytest.mark.parametrize("high", [True, False])
@pytest.mark.parametrize("cut", [True, False])
def test_a_line_is_driven_as_it_is_said_to_act(high: bool, cut: bool) -> None:
    board: Any = Cells({})
    line = replace(LINE, active_high=high)
    drive(RegisterBus(board), line, cut)
    assert (board.line.value, is_cut(RegisterBus(board), line)) == (int(cut is high), cut)


@pytest.mark.parametrize(
    ("decoupler", "cells", "text"),
    [
        (BIT, {0x1004: 0x10}, "the decoupler at 0x1004 reads 0x10 after 0x18 (bits 0x8)"),
        (SEQUENCE, {0x1004: 0, 0x1008: 1}, "the decoupler at 0x1008 reads 0x1 after 0 s, not 0x2 (bits 0xff)"),
        (LINE, {}, "the decoupler, line cut of chip, reads 0 after 1"),
    ],
)
def test_a_decoupler_that_does_not_follow_says_what_it_reads(
    decoupler: Decoupler, cells: dict[int, int], text: str
) -> None:
    class Stuck(SimpleNamespace):
        value = property(lambda _: 0, lambda _, value: None)

    board: Any = Cells(cells, stuck=0x8)
    board.line = Stuck()
    with pytest.raises(VerifyFailed) as refused:
        drive(RegisterBus(board), decoupler, cut=True)
    assert str(refused.value) == text


def test_what_cannot_be_read_back_is_not_taken_for_cut_off() -> None:
    board: Any = Cells({0x1004: 7})
    unread = Decoupler(0x1000, 4, sequence=(IsolationStep(0, 7, 0, verify=False),))
    assert not is_cut(RegisterBus(board), unread)
    assert board.done == []
    half: Any = Cells({0x1004: 0xA0, 0x1008: 1})  # only the first of the steps is as for a cut
    assert not is_cut(RegisterBus(half), SEQUENCE)
