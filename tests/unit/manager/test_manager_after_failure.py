# SPDX-License-Identifier: Apache-2.0
"""After a failure or a kill the board is as the manager says: registers, regions, and what it has learned."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from manager_schemas import REGIONS, written
from manager_support import Rig, killed_at, place_of, rig

from cm.device import DeviceError, Root, Uio
from cm.manager.errors import NothingToUndo
from cm.schema import load
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, CheckRegion, RegWrite
from cm.wire.messages.status import ErrorInfo

SECOND = f"""
config:
  name: second
  type: partial
  device: xc7z020
{REGIONS}
  modules:
    s0: {{region: prr0, identity: 0x50}}
  mmio:
    - base_address: 0x1000
      registers:
        led: {{offset: 0x24, default: 0x61}}
        mixer: {{offset: 0x18, default: 0x62}}
        tint: {{offset: 0x14, default: 0x63}}
  modes:
    default: {{modules: [s0]}}
"""
PLACES = {"led": 0x1018, "scratch": 0x1014, "led of second": 0x1024, "gain": 0x3010, "depth": 0x7010}


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    folder = tmp_path_factory.mktemp("configs")
    (folder / "second.yaml").write_text(SECOND, encoding="utf-8")
    return {**written(folder), "second": load(folder / "second.yaml")}


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started
        sim.control.clear()


def held(sim: SimBoard) -> Mapping[str, int]:
    """The board's registers, read without the manager."""
    found = {}
    for uio in (Uio.open(path.name, Root.of(sim.root)) for path in sorted((sim.root / "dev").glob("uio*"))):
        with uio:
            for name, address in PLACES.items():
                for index, window in enumerate(uio.maps):
                    if window.address <= address < window.address + window.size:
                        found[name] = uio.read(address - window.address, 32, index)
    return found


def written_by_hand(made: Rig) -> Mapping[str, int]:
    """A rig in duo/default with a distinct value in every register, and the board's registers."""
    assert made.go("default", config="duo") is None
    values = {"led": 0x21, "gain": 0x29, "depth": 0x28}
    made.manager.write_registers(tuple(RegWrite(name, value) for name, value in values.items()))
    made.manager.flush()
    return values


def failing_at(made: Rig, number: int, config: str, mode: str) -> ErrorInfo | None:
    made.arm(number)
    error: ErrorInfo | None = made.go(mode, config=config)
    made.fault.at = -1
    return error


# ---- registers --------------------------------------------------------------------------


def test_registers_of_the_static_part_are_what_they_were_when_another_configuration_failed(
    made: Rig, sim: SimBoard
) -> None:
    """Registers with other names, with the same name at another address, and without a name in the previous mode."""
    values, failed = written_by_hand(made), 0
    before = held(sim)
    assert {name: before[name] for name in values} == values
    for number in range(100):
        error = failing_at(made, number, "second", "default")
        if error is None:
            break
        assert "the board is back in duo/default" in error.message or "store" in error.code, error
        assert held(sim) == before, f"operation {number}: {error}"
        failed += 1
    assert failed > 20
    assert {name: held(sim)[name] for name in ("led of second", "led", "scratch")} == {
        "led of second": 0x61,
        "led": 0x62,
        "scratch": 0x63,
    }


@pytest.mark.parametrize("goal", [("duo", "both"), ("second", "default")])
def test_registers_are_what_they_were_after_a_kill(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, goal: tuple[str, str]
) -> None:
    with rig(sim.root, tmp_path, *configs.values()) as first:
        written_by_hand(first)
        before = held(sim)
    number, back = 0, 0
    while killed_at(sim.root, tmp_path, configs.values(), goal, number):
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            status = again.manager.status()
            if (status.config_name, status.mode) == ("duo", "default"):
                assert held(sim) == before, f"killed at operation {number}: {again.notes}"
                back += 1
            else:
                assert (status.config_name, status.mode) == goal
                written_by_hand(again)
        number += 4
    assert back > 5


@pytest.mark.parametrize(("goal", "first"), [(("duo", "both"), 24), (("second", "default"), 30)])
def test_a_start_that_is_killed_while_it_undoes_a_change_loses_nothing(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, goal: tuple[str, str], first: int
) -> None:
    number, ends = 0, 0
    while True:
        with rig(sim.root, tmp_path, *configs.values()) as before:
            written_by_hand(before)
            expected = held(sim)
        assert killed_at(sim.root, tmp_path, configs.values(), goal, first)
        killed = killed_at(sim.root, tmp_path, configs.values(), None, number)
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            assert place_of(again, sim, configs) == "duo/default", f"killed again at operation {number}: {again.notes}"
            assert held(sim) == expected, f"killed again at operation {number}: {again.notes}"
        if not killed:
            break
        number, ends = number + 2, ends + 1
    assert ends > 5


def changed(made: Rig, request: ChangeMode) -> ErrorInfo | None:
    change = made.manager.submit(request)
    assert change.wait(30.0)
    return change.error


UNDO = ChangeMode("duo", "default", undo="c1")


@pytest.mark.parametrize("restarted", [False, True])
@pytest.mark.parametrize("goal", [("duo", "both"), ("second", "default")])
def test_a_change_that_went_well_is_undone_with_all_registers_also_by_the_next_manager(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, goal: tuple[str, str], restarted: bool
) -> None:
    with rig(sim.root, tmp_path, *configs.values()) as first:
        written_by_hand(first)
        before = held(sim)
        assert changed(first, ChangeMode(*goal, undoable="c1")) is None
        first.manager.write_registers((RegWrite("led", 3),))
        assert held(sim) != before
        if not restarted:
            assert changed(first, UNDO) is None
    if restarted:
        with rig(sim.root, tmp_path, *configs.values()) as again:
            assert changed(again, UNDO) is None
    assert held(sim) == before


def test_an_undo_that_is_killed_anywhere_can_be_asked_for_again(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    number = 0
    while True:
        with rig(sim.root, tmp_path, *configs.values()) as first:
            written_by_hand(first)
            before = held(sim)
            assert changed(first, ChangeMode("duo", "both", undoable="c1")) is None
        cut = killed_at(sim.root, tmp_path, configs.values(), UNDO, number)
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            if again.manager.state.mode != "default":
                assert changed(again, UNDO) is None
            assert held(sim) == before, f"killed at operation {number}: {again.notes}"
        if not cut:
            break
        number += 5
    assert number > 20


def test_only_the_last_change_is_undone_and_only_if_its_way_back_was_kept(made: Rig, sim: SimBoard) -> None:
    written_by_hand(made)
    assert changed(made, ChangeMode("duo", "both", undoable="c1")) is None
    assert not_undone(made, ChangeMode("duo", "other", undo="c1")) == (
        "change 'c1' came from duo/default, and does not go back to duo/other"
    )
    gone = "the last change on this board is not {!r}, or its way back was not kept"
    assert not_undone(made, ChangeMode("duo", "default", undo="c2")) == gone.format("c2")
    assert changed(made, ChangeMode("duo", "other")) is None
    assert not_undone(made, UNDO) == gone.format("c1")
    assert changed(made, ChangeMode("whole", "default", undoable="c3")) is None
    assert not_undone(made, ChangeMode("duo", "other", undo="c3")) == (
        "change 'c3' came from an image that is gone, and is not the manager's to load"
    )
    assert changed(made, ChangeMode("duo", "other", undoable="c4")) is None
    assert changed(made, ChangeMode("ported", "only", undoable="c5")) is None
    assert changed(made, ChangeMode("duo", "other", undo="c5")) is None
    assert (made.manager.state.mode, made.manager.state.static_config) == ("other", "whole")
    sim.control.inject("icap_crc")
    assert changed(made, ChangeMode("duo", "default", undoable="c6")) is not None
    assert not_undone(made, ChangeMode("duo", "other", undo="c6")) == gone.format("c6")
    assert changed(made, ChangeMode("duo", "default", undoable="c7")) is None
    assert made.manager.repair(CheckRegion("prr0", repair=True)).wait(30.0)  # which voids nothing
    assert changed(made, ChangeMode("duo", "other", undo="c7")) is None


def not_undone(made: Rig, request: ChangeMode) -> str:
    with pytest.raises(NothingToUndo) as refused:
        made.manager.submit(request)
    return str(refused.value)


# ---- regions ----------------------------------------------------------------------------


def test_a_region_of_the_image_that_was_there_is_coupled_again_unless_its_load_had_begun(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    ends = set()
    for number in range(60):
        sim.control.reset()
        with rig(sim.root, tmp_path / str(number), *configs.values()) as fresh:
            error = failing_at(fresh, number, "duo", "default")
            begun = {"prr0", "prr1"} if fresh.fault.names.count("icap.load") > 1 else set()
            begun |= {"prr0"} if "icap.load" in fresh.fault.names else set()
            assert place_of(fresh, sim, configs) == ("" if error else "duo/default")
            if error is None:
                break
            for region in fresh.manager.status().regions:
                real = sim.control.state()["regions"][region.name]["decoupled"]
                assert real == (region.state == "failed"), f"{number}: {error}: {region}"
                assert region.state != "unknown" or region.name not in begun, f"{number}: {error}: {region}"
                ends.add((region.state, region.name in begun))
    assert {("unknown", False), ("failed", True)} <= ends


def test_a_region_that_stood_cut_off_before_is_not_coupled_by_a_failure(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    sim.control.reset()
    with Uio.open(0x1000, Root.of(sim.root)) as uio:
        uio.write(0, 0b01)
    with rig(sim.root, tmp_path, *configs.values()) as fresh:
        fresh.arm(-1)
        fresh.fault.watch = lambda name: fresh.arm(0) if name == "icap.allocate" else None
        assert fresh.go("default", config="duo") is not None
        fresh.fault.watch = lambda _: None
        regions = sim.control.state()["regions"]
        assert (regions["prr0"]["decoupled"], regions["prr1"]["decoupled"]) == (True, False)


def test_after_a_failed_whole_image_nothing_is_claimed_of_any_region(made: Rig, sim: SimBoard) -> None:
    assert made.go("default", config="duo") is None
    sim.control.inject("fpga_manager_error", count=0)
    error = made.go("default", config="whole")
    assert error is not None
    assert made.manager.state.static_lost
    assert {r.state for r in made.manager.status().regions} == {"unknown"}
    sim.control.clear()
    assert made.go("default", config="whole") is None


@pytest.mark.parametrize("mode", ["both", "lit"])
def test_a_region_that_the_mode_before_leaves_alone_is_whole_after_a_kill(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, mode: str
) -> None:
    with rig(sim.root, tmp_path, *configs.values()) as first:
        for before in ("default", "other"):
            assert first.go(before, config="duo") is None
    number = 0
    while killed_at(sim.root, tmp_path, configs.values(), ("duo", mode), number):
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            there, real = again.manager.status(), sim.control.state()["regions"]
            assert {r.name: (r.module, r.state) for r in there.regions} == {
                name: (real[name]["module"], "ready") for name in ("prr0", "prr1")
            }, f"killed at {number}: {again.notes}"
            assert not any(region["decoupled"] for region in real.values())
            if there.mode == "other":
                assert real["prr1"]["module"] == "a1"
            else:
                assert again.go("default", config="duo") is None
                assert again.go("other", config="duo") is None
        number += 3
    assert number > 8


# ---- what was found out -------------------------------------------------------------------


def test_what_was_found_at_start_is_reported_until_a_client_has_read_it(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    with rig(sim.root, tmp_path, *configs.values()) as first:
        assert first.go("default", config="duo") is None
    assert killed_at(sim.root, tmp_path, configs.values(), ("duo", "both"), 20)
    with rig(sim.root, tmp_path, *configs.values()) as again:
        again.manager.wait_idle()
        assert again.go("other", config="duo") is None
        told = again.manager.status().last_error
        assert told is not None
        assert told.code == "reconciled"
        assert "the change to duo/both was cut short" in told.message
        assert again.manager.status().pr_mode.value == "idle"
        again.manager.reporter.was_read()
        assert again.manager.status().last_error == told  # until something has happened since
        assert again.go("default", config="duo") is None
        assert again.manager.status().last_error is None


# ---- what is said of it --------------------------------------------------------------------------


def persistently(made: Rig, mode: str, *, config: str, at: str, from_: int = 0, back: str = "") -> str:
    """Go there, with each operation `at` failing from a number on, and of the way back those called `back`."""
    count = 0

    def fail(name: str) -> None:
        nonlocal count
        count += name == at
        if (name == at and count > from_) or (count > from_ and name == back):
            raise DeviceError(errno.EIO, f"injected at {name}")

    made.arm(-1)
    made.fault.watch = fail
    error = made.go(mode, config=config)
    made.fault.watch = lambda _: None
    assert error is not None
    return f"{error.code}: {error.message}"


GONE = (
    "going back failed too: the static part that duo was running in is gone, and it is not the manager's to load: load "
    "a full configuration, or restart the board"
)


@pytest.mark.parametrize(
    ("before", "goal", "fails", "text"),
    [
        (
            [],
            ("duo", "default"),
            {"at": "icap.load", "from_": 1},
            "device_error: load a1 into prr1 by icap: injected at icap.load; there was no mode to go back to; "
            "regions left decoupled: prr0, prr1",
        ),
        (
            [],
            ("duo", "default"),
            {"at": "overlays.apply"},
            "device_error: apply overlay duo_base: injected at overlays.apply; there was no mode to go back to; "
            "no region was loaded",
        ),
        (
            [("duo", "default")],
            ("duo", "both"),
            {"at": "icap.load", "from_": 1},
            "undo_failed: load b1 into prr1 by icap: injected at icap.load; going back failed too: injected at "
            "icap.load; regions left decoupled: prr0, prr1",
        ),
        (
            [("duo", "default")],
            ("duo", "both"),
            {"at": "icap.load", "back": "uio.write"},
            "undo_failed: load b0 into prr0 by icap: injected at icap.load; going back failed too: injected at "
            "uio.write; regions left decoupled: prr0, prr1; prr0 could not be decoupled: injected at uio.write; prr1 "
            "could not be decoupled: injected at uio.write",
        ),
        (
            [("duo", "default")],
            ("whole", "default"),
            {"at": "fpga_manager.load"},
            "undo_failed: load the whole device from whole.bit by fpga_manager: injected at fpga_manager.load; "
            f"{GONE}; what the device holds is not known, so nothing in it is accessed",
        ),
        (
            [("duo", "default")],
            ("ported", "only"),
            {"at": "uio.write"},
            f"undo_failed: set led = 0x9: injected at uio.write; {GONE}; the device holds the image of ported, and is "
            "in no mode",
        ),
        (
            [],
            ("duo", "default"),
            {"at": "uio.write", "from_": 4},
            "device_error: set gain = 0x1: injected at uio.write; there was no mode to go back to; what was loaded "
            "stays, in no mode",
        ),
        (
            [("duo", "default")],
            ("whole", "full"),
            {"at": "icap.load"},
            f"undo_failed: load w0 into prr0 by icap: injected at icap.load; {GONE}; regions left decoupled: prr0, "
            "prr1",
        ),
        (
            [("duo", "default"), ("duo", "other")],
            ("duo", "both"),
            {"at": "icap.allocate"},
            "device_error: load b1 into prr1 by icap: injected at icap.allocate; the board is back in duo/other",
        ),
        (
            [("duo", "other")],
            ("duo", "both"),
            {"at": "icap.load"},
            "device_error: load b1 into prr1 by icap: injected at icap.load; the board is back in duo/other; regions "
            "left decoupled: prr1",
        ),
    ],
)
def test_an_error_says_which_step_failed_and_what_the_board_holds_now(
    sim: SimBoard,
    configs: dict[str, Config],
    tmp_path: Path,
    before: list[tuple[str, str]],
    goal: tuple[str, str],
    fails: dict[str, Any],
    text: str,
) -> None:
    sim.control.reset()
    with rig(sim.root, tmp_path, *configs.values()) as made:
        for config, mode in before:
            assert made.go(mode, config=config) is None
        assert persistently(made, goal[1], config=goal[0], **fails) == text
        there = made.manager.status()
        failed = [region.name for region in there.regions if region.state == "failed"]
        assert all(sim.control.state()["regions"][name]["decoupled"] for name in failed)
        back = f"back in {there.config_name}/{there.mode}"
        assert (back in text) is ("is back in" in text)
    sim.control.reset()


def test_an_error_says_what_was_loaded_again_on_the_way_back(made: Rig, sim: SimBoard) -> None:
    assert made.go("default", config="duo") is None
    sim.control.inject("register_stuck", "gain")
    error = made.go("both", config="duo")
    assert error.code == "undo_failed"
    assert error.message.endswith("; loaded again with what they held before: prr0, prr1")
    there = made.manager.status()
    assert (there.mode, there.pr_mode.value) == ("default", "error")
    assert {r["module"] for r in sim.control.state()["regions"].values()} == {"a0", "a1"}


def test_a_change_that_is_refused_before_it_touched_anything_is_no_error_of_the_board(made: Rig) -> None:
    assert made.go("default", config="duo") is None
    made.fault.watch = lambda name: (
        (_ for _ in ()).throw(OSError(errno.EROFS, "read")) if name[:7] == "journal" else None
    )
    error = made.go("both", config="duo")
    made.fault.watch = lambda _: None
    status = made.manager.status()
    assert (error.code, error.message[-20:]) == ("store", "; nothing was touched"[-20:])
    assert (status.last_error, status.mode, status.pr_mode.value) == (error, "default", "idle")
