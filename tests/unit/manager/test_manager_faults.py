# SPDX-License-Identifier: Apache-2.0
"""Loads that take too long, boards that others changed, and a record that cannot be written."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_support import Rig, camera, make_rig, place_of, rig

from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import RegWrite

HUNG = 60.0  # seconds for a load: a busy machine may take some


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with SimBoard(arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, camera(timeout=HUNG)) as started:
        assert started.go("default") is None
        yield started
        sim.control.clear()


def truth(sim: SimBoard) -> dict[str, object]:
    """What the board really holds."""
    state = sim.control.state()
    region = state["regions"]["prr0"]
    return {"module": region["module"], "decoupled": region["decoupled"], "overlays": sorted(state["overlays"])}


def settled(made: Rig, sim: SimBoard) -> str:
    """Where the board is, a mode or ``cut off``, which is told."""
    place, error = place_of(made, sim, {"camera": camera()}), made.manager.status().last_error
    assert place or (error is not None and "prr0" in error.message)
    return place.removeprefix("camera/") or "cut off"


def operations(made: Rig) -> int:
    """How many operations going to edge_detection takes; the board is back in default afterwards."""
    made.arm(-1)
    assert made.go("edge_detection") is None
    count = len(made.fault.names)
    assert made.go("default") is None
    assert count > 20
    return count


def test_a_load_that_takes_too_long_is_given_up_and_undone(sim: SimBoard, tmp_path: Path) -> None:
    with rig(sim.root, tmp_path, camera(timeout=HUNG)) as patient:
        assert patient.go("default") is None
    with rig(sim.root, tmp_path, camera(timeout=0.05)) as hasty:
        sim.control.inject("icap_hang")
        error = hasty.go("edge_detection")
        assert error is not None
        # The port may be held for longer than the time-out, or have given up by itself before a busy machine looked.
        assert error.code in ("step_timeout", "undo_failed", "load_failed")
        assert settled(hasty, sim) in ("default", "cut off")
    with rig(sim.root, tmp_path, camera(timeout=HUNG)) as again:
        again.manager.wait_idle()
        assert again.go("default") is None
        assert settled(again, sim) == "default"


def test_a_register_that_does_not_keep_its_value_brings_the_board_back(sim: SimBoard, tmp_path: Path) -> None:
    with rig(sim.root, tmp_path, camera(defaults={"threshold": 40})) as made:
        assert made.go("default") is None
        sim.control.inject("register_stuck", "threshold")
        error = made.go("edge_detection")
        sim.control.clear()
        assert error is not None
        assert error.code == "verify_failed"
        assert settled(made, sim) == "default"


def test_a_board_that_was_restarted_holds_nothing(tmp_path: Path) -> None:
    with SimBoard(arguments=["--icap-rate", "0"]) as fresh:
        with rig(fresh.root, tmp_path) as first:
            assert first.go("edge_detection") is None
        fresh.kill()
        fresh.restart()
        with rig(fresh.root, tmp_path) as second:
            assert second.manager.status().config_name == ""
            assert any("restarted" in note for note in second.notes)
            assert second.go("edge_detection") is None
        with rig(fresh.root, tmp_path, new_board=True) as third:  # is the same one
            assert third.manager.status().mode == "edge_detection"
        fresh.kill()
        fresh.restart()
        with rig(fresh.root, tmp_path, new_board=True) as another:
            assert (another.manager.status().config_name, another.notes) == ("", ())


# ---- the record ---------------------------------------------------------------------


class Disk:
    """Makes every write of the record fail from operation `at` on, like a card that turns read-only."""

    def __init__(self, made: Rig, at: int = 0) -> None:
        self._fault, self._at = made.fault, at
        made.fault.watch = self

    def __call__(self, name: str) -> None:
        if name == "journal.write" and len(self._fault.names) >= self._at:
            raise OSError(errno.EROFS, "Read-only file system")


def test_a_record_that_cannot_be_written_refuses_the_change_before_anything_is_touched(
    made: Rig, sim: SimBoard
) -> None:
    made.arm(-1)
    Disk(made)
    for _ in range(2):
        error = made.go("edge_detection")
        assert error is not None
        assert error.code == "store"
        assert "Read-only file system" in error.message
        assert error.message.endswith("; nothing was touched")
        assert made.manager.status().pr_mode.value == "idle"
        assert set(made.fault.names) <= {"journal.write"}
        assert settled(made, sim) == "default"
    made.fault.watch = lambda _: None
    assert made.go("edge_detection") is None


def test_a_record_that_fails_from_any_operation_on_leaves_the_board_whole(made: Rig, sim: SimBoard) -> None:
    """The last operation is the record that the mode was entered: nothing is done before it is written."""
    for number in range(operations(made)):
        made.arm(-1)
        Disk(made, number)
        error = made.go("edge_detection")
        assert settled(made, sim) == "default", f"operation {number}: {error}"
        assert error.code == "store"
        assert made.manager.status().last_error == error
        made.fault.watch = lambda _: None
        assert made.go("default") is None


def test_a_manager_that_dies_after_its_record_failed_comes_back_to_the_mode_before(
    sim: SimBoard, tmp_path: Path
) -> None:
    """The record on disk is older than the last operation, but still leads to the previous mode."""
    with rig(sim.root, tmp_path, camera(timeout=HUNG)) as first:
        assert first.go("default") is None
        count = operations(first)
    for number in (*range(1, count, 2), count):
        with rig(sim.root, tmp_path, camera(timeout=HUNG)) as dying:
            assert dying.go("default") is None
            dying.arm(-1)
            Disk(dying, number)
            error = dying.go("edge_detection")  # no record of what became of it, nor of the end: as if killed
            told = settled(dying, sim)
            assert told == ("default" if error else "edge_detection")
        with rig(sim.root, tmp_path, camera(timeout=HUNG)) as again:
            again.manager.wait_idle()
            recorded = number >= count  # that the mode was entered is the last that is recorded
            assert settled(again, sim) == told == ("edge_detection" if recorded else "default"), f"operation {number}"
            assert recorded or any("cut short" in note for note in again.notes)


def test_a_manager_starts_where_the_record_cannot_be_written(sim: SimBoard, tmp_path: Path) -> None:
    fresh = make_rig(sim.root, tmp_path, camera(timeout=HUNG))
    Disk(fresh)
    try:
        fresh.manager.start()
        assert fresh.manager.status().last_error.code == "store"  # type: ignore[union-attr]
        error = fresh.go("default")
        assert error is not None
        assert error.code == "store"
        assert fresh.manager.status().configs == ("camera",)
    finally:
        fresh.close()


def test_on_a_disk_that_became_read_only_the_board_is_served_and_changes_are_refused(
    sim: SimBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with rig(sim.root, tmp_path, camera(timeout=HUNG)) as first:
        assert first.go("default") is None
    opened = os.open

    def read_only(path: object, flags: int, *rest: Any, **more: Any) -> int:
        if str(path).startswith(str(tmp_path)) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        return opened(path, flags, *rest, **more)  # type: ignore[call-overload,no-any-return]

    monkeypatch.setattr(os, "open", read_only)
    with rig(sim.root, tmp_path, camera(timeout=HUNG)) as again:
        status = again.manager.status()
        assert (status.mode, status.last_error.code) == ("default", "store")  # type: ignore[union-attr]
        again.manager.write_registers((RegWrite("led", 5),))
        assert again.manager.registers.read(("led",)).values[0].value == 5
        error = again.go("edge_detection")
        assert (error.code, error.message.endswith("; nothing was touched")) == ("store", True)
        assert settled(again, sim) == "default"
        monkeypatch.undo()
        assert again.go("edge_detection") is None
