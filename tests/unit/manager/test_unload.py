# SPDX-License-Identifier: Apache-2.0
"""What is unloaded is isolated, and nothing of it is offered; the walk and random changes try each failure and kill."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from manager_support import Rig, rig

from cm.device import Root, Uio
from cm.errors import CmError, InvalidRequest
from cm.manager.errors import HeldBy, NothingLoaded, UnknownRegion
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, RegWrite, TakeLease


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        assert started.go("both", config="duo") is None
        yield started
        sim.control.clear()


def told(made: Rig) -> Mapping[str, tuple[str, str]]:
    return {region.name: (region.module or "", region.state) for region in made.manager.status().regions}


def kinds(made: Rig, unload: str) -> list[tuple[str, str]]:
    plan = made.manager.plan(ChangeMode(unload=unload))
    return [(step.kind, step.subject) for step in plan.steps]


def test_a_region_that_the_mode_needs_takes_the_mode_and_its_overlays_with_it(made: Rig, sim: SimBoard) -> None:
    assert kinds(made, "prr1") == [
        ("validate", ""), ("quiesce", "through0, through1"), ("overlay_remove", "duo_extra"), ("decouple", "prr1"),
        ("publish", "duo/no mode"),
    ]  # fmt: skip
    assert made.go("-prr1", config="duo") is None
    status, held = made.manager.status(), sim.control.state()
    assert (status.config_name, status.mode, status.pr_mode.value) == ("duo", "", "idle")
    assert told(made) == {"prr0": ("b0", "ready"), "prr1": ("", "decoupled")}
    assert [held["regions"][name]["decoupled"] for name in ("prr0", "prr1")] == [False, True]
    assert held["overlays"] == ["duo_base"]
    assert made.data_plane.runs[:2] == ("duo", None)
    with pytest.raises(CmError, match="prr1"):
        made.manager.registers.read(("depth",))
    assert made.manager.registers.read(("gain",)).values[0].value == 1  # of a region that stays
    made.manager.write_registers((RegWrite("led", 3),))  # of the static part
    assert kinds(made, "prr1") == []
    assert made.go("-prr1", config="duo") is None


def test_the_mode_goes_on_without_a_region_that_it_does_not_need(made: Rig, sim: SimBoard) -> None:
    assert made.go("other", config="duo") is None
    assert made.go("-prr1", config="duo") is None
    status = made.manager.status()
    assert (status.mode, told(made)["prr1"]) == ("other", ("", "decoupled"))
    assert made.data_plane.runs[:2] == ("duo", "other")
    assert made.manager.registers.read(("gain",)).values[0].value == 1
    assert sim.control.state()["regions"]["prr1"]["decoupled"]


def test_what_was_unloaded_is_loaded_again_as_a_whole(made: Rig, sim: SimBoard) -> None:
    made.manager.write_registers((RegWrite("depth", 9),))
    assert made.go("-*", config="duo") is None
    loads = sim.control.state()["loads"]
    assert made.go("both", config="duo") is None
    assert sim.control.state()["loads"] == loads + 2
    assert told(made) == {"prr0": ("b0", "ready"), "prr1": ("b1", "ready")}
    assert made.manager.registers.read(("depth",)).values[0].value == 2  # its default


def test_what_is_loaded_by_overlay_goes_with_it(made: Rig, sim: SimBoard) -> None:
    assert made.go("both", config="kernel") is None
    assert made.go("-prr1", config="kernel") is None
    assert sim.control.state()["overlays"] == ["cm-prr0"]


def test_it_stays_unloaded_when_the_manager_starts_anew(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    assert made.go("-prr1", config="duo") is None
    made.close()
    with rig(sim.root, tmp_path, *configs.values()) as again:
        again.manager.wait_idle()
        assert again.notes == ()
        assert (again.manager.status().config_name, again.manager.status().mode) == ("duo", "")
        assert told(again) == {"prr0": ("b0", "ready"), "prr1": ("", "decoupled")}
    with Uio.open("uio0", Root.of(sim.root)) as static:  # somebody else connects it
        static.write(0, 0)
    with rig(sim.root, tmp_path, *configs.values()) as blind:
        assert blind.notes == ("region prr1 was unloaded, but is not known to be isolated any more",)
        assert told(blind)["prr1"] == ("", "unknown")


def test_a_load_that_fails_leaves_it_unloaded_and_the_others_too(made: Rig, sim: SimBoard) -> None:
    assert made.go("-*", config="duo") is None
    sim.control.inject("icap_crc")
    error = made.go("other", config="duo")
    assert error.message.endswith("there was no mode to go back to; regions left decoupled: prr0")
    assert told(made) == {"prr0": ("", "decoupled"), "prr1": ("", "decoupled")}
    sim.control.clear()
    assert made.go("other", config="duo") is None
    sim.control.inject("icap_crc")
    assert "the board is back in duo/other" in made.go("default", config="duo").message
    assert told(made) == {"prr0": ("b0", "ready"), "prr1": ("", "decoupled")}


def test_who_holds_a_region_keeps_it(made: Rig) -> None:
    lease = made.manager.leases.request(TakeLease("registers:depth", True))
    assert made.go("-prr0", config="duo") is None
    for unload in ("prr1", "*"):
        with pytest.raises(HeldBy):
            made.manager.submit(ChangeMode(unload=unload))
    change = made.manager.submit(ChangeMode(unload="*", lease=lease.id), by="anna")
    assert change.wait(30)
    (*_, past) = made.manager.reporter.history.changes()
    assert (past.by, past.why, past.mode, past.from_mode) == ("anna", "to unload prr0, prr1", "", "")


@pytest.mark.parametrize(
    ("request_", "error", "said"),
    [
        (ChangeMode(unload="prr2"), UnknownRegion, "no region 'prr2'"),
        (ChangeMode("kernel", unload="*"), NothingLoaded, "kernel is not loaded"),
        (ChangeMode(mode="both", unload="*"), InvalidRequest, "goes to no mode"),
        (ChangeMode(unload="*", force=True), InvalidRequest, "goes to no mode"),
    ],
)
def test_what_cannot_be_unloaded_is_refused(made: Rig, request_: ChangeMode, error: type[CmError], said: str) -> None:
    for ask in (made.manager.submit, made.manager.plan):
        with pytest.raises(error, match=said):
            ask(request_)
    assert made.manager.status().mode == "both"


def test_what_another_change_has_replaced_meanwhile_is_not_unloaded(made: Rig) -> None:
    first = made.manager.submit(ChangeMode("kernel", "both"))
    change = made.manager.submit(ChangeMode(unload="*"))
    assert first.wait(30)
    assert change.wait(30)
    assert change.error is not None
    assert change.error.code == "nothing_loaded"
    assert made.manager.status().mode == "both"
