# SPDX-License-Identifier: Apache-2.0
"""What the manager remembers of changes and writes, and who asked for them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_schemas import written
from manager_support import Rig, rig

from cm.manager.history import CHANGES
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, RegWrite


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with SimBoard(arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path) as started:
        assert started.go("default") is None
        yield started
        sim.control.clear()


def test_a_change_is_remembered_with_who_asked_for_it_and_its_steps(made: Rig) -> None:
    made.manager.submit(ChangeMode("camera", "edge_detection"), by="anna (uid 1001, pid 811)").wait()
    _, last = made.manager.reporter.history.changes()
    assert (last.by, last.from_config, last.from_mode, last.mode) == (
        "anna (uid 1001, pid 811)", "camera", "default", "edge_detection",
    )  # fmt: skip
    assert (last.error, last.why) == (None, "")
    order = [(step.kind, step.subject) for step in last.steps]
    cut, load, again = (order.index((kind, "prr0")) for kind in ("decouple", "load", "recouple"))
    assert cut < load < again
    assert 0 < last.steps[load].port_seconds <= last.steps[load].seconds
    times = [step.begun_ns for step in last.steps]
    assert last.begun_ns <= times[0]
    assert times == sorted(times)
    assert times[-1] <= last.ended_ns


def test_the_step_that_failed_and_the_way_back_are_remembered(made: Rig, sim: SimBoard) -> None:
    sim.control.inject("icap_crc")
    error = made.go("edge_detection")
    last = made.manager.reporter.history.changes()[-1]
    assert last.error == error
    assert [(step.kind, step.subject, step.back) for step in last.steps if step.failed] == [("load", "prr0", False)]
    assert ("load", "prr0") in [(step.kind, step.subject) for step in last.steps if step.back]


def test_the_change_that_has_loaded_a_region_is_remembered_however_many_follow(made: Rig) -> None:
    for _ in range(CHANGES + 2):
        assert made.go("default") is None  # loads nothing
    changes = made.manager.reporter.history.changes()
    assert [change.number for change in changes] == [1, *range(4, CHANGES + 4)]
    assert any(step.kind == "load" for step in changes[0].steps)


def test_the_last_write_of_a_register_is_remembered(made: Rig) -> None:
    for value in (4, 5):
        made.manager.write_registers((RegWrite("focus", value), RegWrite("zoom", 1)), by="anna")
    history = made.manager.reporter.history
    assert [(w.name, w.value, w.by) for w in history.writes()] == [("focus", 5, "anna"), ("zoom", 1, "anna")]
    assert made.go("default") is None
    assert len(history.writes()) == 2


def test_writes_of_another_configuration_are_forgotten(tmp_path: Path) -> None:
    configs = written(tmp_path, ("duo", "whole"))
    paths = [config.source for config in configs.values() if config.source]
    with SimBoard(paths, arguments=["--icap-rate", "0"]) as board, rig(board.root, tmp_path, *configs.values()) as made:
        assert made.go("default", config="duo") is None
        made.manager.write_registers((RegWrite("led", 1),))
        assert [write.name for write in made.manager.reporter.history.writes()] == ["led"]
        assert made.go("default", config="whole") is None
        assert made.manager.reporter.history.writes() == ()


def test_a_change_that_nobody_asked_for_says_why(made: Rig) -> None:
    made.manager.board_slept()
    made.manager.wait_idle()
    last = made.manager.reporter.history.changes()[-1]
    assert last.why.startswith("as the machine slept")
    assert last.by == ""
