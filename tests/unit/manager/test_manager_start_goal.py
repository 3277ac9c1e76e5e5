# SPDX-License-Identifier: Apache-2.0
"""Where a request goes, and what a manager takes a board for at its start: no board, no files."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest

from cm.device import DeviceError, DeviceNotFound
from cm.errors import CmError
from cm.manager.access.register_bus import RegisterBus
from cm.manager.inputs import Window
from cm.manager.planner import target
from cm.manager.recovery import Destination, Finding, destination, is_whole, reconcile, repair
from cm.manager.state.board_state import (
    TRANSITIONS,
    BoardState,
    IllegalTransition,
    OverlayState,
    RegionEvent,
    RegionPhase,
    RegionState,
    slept,
)
from cm.manager.state.journal import Pending, Record
from cm.schema import loads
from cm.schema.model import Config
from cm.wire.messages.requests import ChangeMode

FILES: Any = SimpleNamespace()  # of which nothing is asked: schemas here have no text of their own


def config(name: str, kind: str) -> Config:
    return loads(f"config:\n  name: {name}\n  type: {kind}\n  modes: {{one: {{}}, two: {{}}}}\n")


PARTIAL, OTHER, FULL = config("part", "partial"), config("other", "partial"), config("whole", "full")
ALL = {"part": PARTIAL, "other": OTHER, "whole": FULL}


def pending(from_config: str | None, from_mode: str | None, from_static: str | None = None) -> Pending:
    return Pending(7, "other", "two", from_config, from_mode, from_static=from_static)


@pytest.mark.parametrize(
    ("state", "cut", "there"),
    [
        (BoardState("part", "two"), None, Destination(PARTIAL, "two")),
        (BoardState("part", "two"), pending("whole", "one"), Destination(PARTIAL, "two")),
        (BoardState(), None, None),
        (BoardState("gone", "one"), None, None),
        (BoardState("part", "gone"), None, None),
        (BoardState("part", None), pending("whole", "one"), None),  # a known configuration is not left
        # the change has lost the image: it goes back if that is served
        (BoardState(), pending("whole", "one"), Destination(FULL, "one")),
        (BoardState(), pending("part", "two", "whole"), Destination(PARTIAL, "two", "whole")),
        (BoardState(), pending("part", "two"), None),
        (BoardState(), pending("part", "two", "gone"), None),
        (BoardState(), pending("part", "gone", "whole"), None),
        (BoardState(), pending("part", None, "whole"), None),
        (BoardState(), pending("gone", "one", "whole"), None),
        (BoardState(), pending(None, None), None),
    ],
)
def test_a_board_stays_in_its_mode_or_goes_back_to_the_one_before(
    state: BoardState, cut: Pending | None, there: Destination | None
) -> None:
    assert destination(state, cut, ALL) == there


# ---- where a request goes ----------------------------------------------------------------

LAB = loads("""
config:
  name: lab
  default_mode: both
  regions:
    left: {decoupler: {base_address: 0x1000, offset: 0}, identity: {base_address: 0x2000, offset: 0x10}}
    right: {loader: auto, loader_name: icap0}
  modules: {fir: {region: left, identity: 1}, iir: {region: left, identity: 2}, fft: {region: right}}
  overlays: [base]
  clocks: {fclk0: 100_000_000}
  mmio:
    - base_address: 0x1000
      registers:
        led: {offset: 0x10, reset: 3}
        count: {offset: 0x14, volatile: true}
        key: {offset: 0x18, access: wo}
        tone: {offset: 0x1c, default: 4}
    - {base_address: 0x2000, region: left, registers: {gain: {offset: 0x20}}}
  modes:
    slow: {modules: [fir]}
    fast: {modules: [fir]}
    both: {modules: [fir, fft], overlays: [extra]}
    other: {modules: [iir]}
""")
SERVED = {"lab": LAB, "part": PARTIAL}


@pytest.mark.parametrize(
    ("asked", "loaded", "there"),
    [
        ({"config_name": "lab"}, None, ("lab", "both")),
        ({"config_name": "part"}, "lab", ("part", "one")),
        ({"config_name": "part", "mode": "two"}, "lab", ("part", "two")),
        ({"mode": "slow"}, "lab", ("lab", "slow")),
        ({}, "lab", ("lab", "both")),
        ({"name_or_mode": "slow"}, "lab", ("lab", "slow")),
        ({"name_or_mode": "iir"}, "lab", ("lab", "other")),
        ({"name_or_mode": "part"}, "lab", ("part", "one")),
        ({"name_or_mode": "lab"}, None, ("lab", "both")),
        ({}, None, "nothing is loaded: name a configuration (lab, part)"),
        ({"config_name": "lob"}, None, "no configuration 'lob'; did you mean 'lab'?"),
        ({"config_name": "xyz"}, None, "no configuration 'xyz'; there are lab, part"),
        ({"mode": "slaw"}, "lab", "configuration 'lab' has no mode 'slaw'; did you mean 'slow'?"),
        ({"mode": "iir"}, "lab", "configuration 'lab' has no mode 'iir'; mode 'other' has that module alone"),
        ({"name_or_mode": "fats"}, "lab", "configuration 'lab' has no mode 'fats'; did you mean 'fast'?"),
        (
            {"name_or_mode": "fir"},
            "lab",
            "module 'fir' alone makes several modes of 'lab': slow, fast; name one",
        ),
        (
            {"name_or_mode": "slow"},
            None,
            "nothing is loaded and 'slow' is not a configuration; there are lab, part",
        ),
    ],
)
def test_a_request_goes_to_a_mode_or_is_refused_with_what_there_is(
    asked: dict[str, str], loaded: str | None, there: tuple[str, str] | str
) -> None:
    if isinstance(there, tuple):
        assert target(ChangeMode(**asked), SERVED, loaded) == (SERVED[there[0]], there[1])
        return
    with pytest.raises(CmError) as caught:
        target(ChangeMode(**asked), SERVED, loaded)
    assert str(caught.value) == there


# ---- what the board is taken for ----------------------------------------------------------

READY, CUT = RegionPhase.READY, RegionPhase.DECOUPLED
HELD = {"left": RegionState(READY, "fir", "f1"), "right": RegionState(READY, "fft", "f2")}
BOTH = BoardState(
    "lab",
    "both",
    LAB.sha256_source,
    regions=HELD,
    overlays=(OverlayState("base", "b"), OverlayState("extra", "e")),
    values=MappingProxyType({"led": 5, "gain": 7, "tone": 0}),
    clocks={"fclk0": 99},
)


class Board:
    """A board as it stands: overlays, a clock, the kernel's loader, registers; none of it changes but overlays."""

    def __init__(self, **there: Any) -> None:
        self.overlays_on = there.get("overlays", ["base", "extra"])
        self.clock: int | None = there.get("clock", 99)
        self.said: str | None = there.get("said", "operating")
        self.id = there.get("id", "boot")
        self.cells: Mapping[int, int | None] = {0x1000: 0, 0x2010: 1, 0x1010: 5, 0x101C: 0, 0x2020: 7} | there.get(
            "cells", {}
        )

    def boot_id(self) -> str:
        return str(self.id)

    def overlays(self) -> Any:
        there = self.overlays_on
        if there is None:
            return SimpleNamespace(available=lambda: False)
        return SimpleNamespace(available=lambda: True, list=lambda: [*there], remove=there.remove)

    def clocks(self) -> Any:
        return SimpleNamespace(names=lambda: [] if self.clock is None else ["fclk0"], find=self._clock)

    def _clock(self, name: str) -> Any:
        if not self.clock:
            raise DeviceNotFound(errno.ENOENT, f"no clock {name}")
        return SimpleNamespace(rate=self.clock)

    def icap(self, name: str | None) -> Any:
        raise DeviceNotFound(errno.ENOENT, "none")

    def fpga_manager(self, name: str | None) -> Any:
        if name is not None or self.said is None:
            raise DeviceNotFound(errno.ENOENT, "none")
        return SimpleNamespace(state=self.said, can_load=True)

    def window(self, address: int, width: int) -> Window:
        return Window(self, 0, address)  # type: ignore[arg-type]

    def read(self, offset: int, width: int = 32, number: int = 0) -> int:
        value = self.cells[offset]
        if value is None:
            raise DeviceError(errno.EIO, "no answer")
        return value


def found(state: BoardState, cut: Pending | None = None, **there: Any) -> tuple[Finding, Board]:
    board: Any = Board(**there)
    return reconcile(Record("boot", state, cut), {"lab": LAB}, board, RegisterBus(board), FILES), board


def lost(*names: str) -> dict[str, RegionState]:
    return {name: RegionState() if name in names else region for name, region in HELD.items()}


def changing(step: str, subject: str = "", **more: Any) -> Pending:
    return Pending(7, "lab", "other", "lab", "both", step, subject, held={"left": "fir", "right": "fft"}, **more)


SAID = "the change to lab/other was cut short at"


@pytest.mark.parametrize(
    ("there", "change", "notes"),
    [
        ({}, {}, []),
        ({"id": "", "overlays": []}, None, ["the boot id cannot be read, so the record may be of before a restart"]),
        ({"id": "next", "overlays": None}, None, ["the board was restarted; what it held (lab/both) is gone"]),
        (
            {"overlays": ["cm-right", "theirs", "base", "extra"]},
            {"overlays": BOTH.overlays},
            ["overlay cm-right, left over from a load that was cut short, was removed"],
        ),
        ({"overlays": ["extra"]}, {"overlays": BOTH.overlays[1:]}, ["overlay base is no longer applied"]),
        (
            {"overlays": ["base", "extra", "cm-left"]},
            {},
            ["overlay cm-left, left over from a load that was cut short, was removed"],
        ),
        ({"clock": 98}, {"clocks": {}}, ["clock fclk0 runs at 0.000098 MHz, it was set to 0.000099 MHz"]),
        ({"clock": 0}, {"clocks": {}}, ["clock fclk0 cannot be read (no clock fclk0)"]),
        ({"said": None}, {}, []),
        (
            {"said": "write error"},
            {"regions": lost("right")},
            ["the fpga_manager says 'write error', so the content of region right is not trusted"],
        ),
        (
            {"said": "power off"},
            {"regions": lost("right")},
            ["the fpga_manager says 'power off', so the content of region right is not trusted"],
        ),
        (
            {"cells": {0x1000: 1}},
            {"regions": lost("left")},
            ["region left: it stands decoupled; its content is not trusted"],
        ),
        (
            {"cells": {0x1000: None}},
            {"regions": lost("left")},
            ["region left: its decoupler cannot be read (no answer); its content is not trusted"],
        ),
        (
            {"cells": {0x2010: 2}},
            {"regions": lost("left")},
            ["region left: its identity register reads 0x2, fir is 0x1; its content is not trusted"],
        ),
        (
            {"cells": {0x2010: None}},
            {"regions": lost("left")},
            ["region left: its identity register cannot be read (no answer); its content is not trusted"],
        ),
        ({"cells": {0x1010: 8, 0x2020: 9, 0x101C: 1}}, {"values": {"led": 8, "gain": 9, "tone": 1}}, []),
        ({"cells": {0x1010: None, 0x2020: None, 0x101C: 1}}, {"values": BOTH.values | {"tone": 1}}, []),
    ],
)
def test_what_is_recorded_is_kept_as_far_as_the_board_agrees(
    there: dict[str, Any], change: dict[str, Any] | None, notes: list[str]
) -> None:
    finding, board = found(BOTH, **there)
    assert list(finding.notes) == notes
    assert finding.state == (BoardState() if change is None else replace(BOTH, **change))
    assert not {"cm-left", "cm-right"} & {*(board.overlays_on or ())}


def test_a_whole_image_that_the_kernel_says_went_wrong_leaves_nothing_to_trust() -> None:
    board: Any = Board(said="write error")
    record = Record("boot", replace(BOTH, static_sha256="w", static_config="whole"))
    finding = reconcile(record, {"lab": LAB, "whole": FULL}, board, RegisterBus(board), FILES)
    assert finding.state == slept(record.state)
    assert finding.notes == (
        "the fpga_manager says 'write error', so what whole loaded is not trusted",
        "a load of a full image did not end well; nothing in the device is accessed",
    )


def test_overlays_that_only_a_lost_record_knew_are_taken_for_ours() -> None:
    board: Any = Board(overlays=["theirs", "extra", "cm-left"])
    finding = reconcile(None, {"lab": LAB}, board, RegisterBus(board), FILES)
    assert finding.state == BoardState(overlays=(OverlayState("extra", ""), OverlayState("cm-left", "")))
    assert finding.notes == (
        "overlay extra is applied, but not recorded; the next change removes it",
        "overlay cm-left is applied, but not recorded; the next change removes it",
    )


@pytest.mark.parametrize(
    ("before", "cut", "there", "change", "notes"),
    [
        ({}, changing("quiesce"), {}, {}, [f"{SAID} quiesce"]),
        (
            {},
            changing("decouple", "left"),
            {},
            {"regions": HELD | {"left": RegionState(CUT, "fir", "f1")}},
            ["region left was decoupled, with fir in it", f"{SAID} decouple"],
        ),
        ({}, changing("repair", "left"), {}, {"regions": lost("left")}, [f"{SAID} repair"]),
        ({"regions": lost("right")}, None, {}, {}, []),  # as it was known before
        ({"values": {"gain": 7, "tone": 0}}, None, {"cells": {0x1010: 3}}, {}, []),  # as its reset left it
        ({"clocks": {"fclk0": 0}}, None, {"clock": None}, {}, []),  # which nothing sets
        (
            {"mode": "slow", "regions": HELD | {"right": RegionState(CUT, "fft", "f2")}},  # it was ready before
            changing("load", "left"),
            {},
            {},
            ["region right was decoupled, with fft in it", f"{SAID} load"],
        ),
        ({"mode": "gone"}, None, {"cells": {0x1010: 8}}, {}, []),  # whose registers are not known
        ({}, changing("registers", "led"), {}, {"values": {"gain": 7, "tone": 0, "led": 5}}, [f"{SAID} registers"]),
        (
            {},
            changing("registers", "led"),
            {"cells": {0x1010: None}},
            {"values": {"gain": 7, "tone": 0}},
            [f"{SAID} registers"],
        ),
        (
            {"overlays": ()},
            changing("overlay_apply", "extra", overlay="extra"),
            {"overlays": ["extra"]},
            {},
            ["overlay extra, left over from the change that was cut short, was removed", f"{SAID} overlay_apply"],
        ),
        ({}, changing("overlay_remove", "extra", overlay="extra"), {}, {}, [f"{SAID} overlay_remove"]),
        (
            {"regions": HELD | {"right": RegionState(RegionPhase.LOADED, "fft", "f2")}},
            changing("recouple", "right"),
            {},
            {},
            ["region right was loaded, with fft in it", f"{SAID} recouple"],
        ),
        (
            {"regions": HELD | {"right": RegionState(RegionPhase.LOADING)}},
            changing("load", "right"),
            {},
            {"regions": lost("right")},
            ["region right was loading; its content is not trusted", f"{SAID} load"],
        ),
        (
            {"regions": HELD | {"right": RegionState(RegionPhase.FAILED, "fft", "f2")}},
            None,
            {},
            {"regions": lost("right")},
            ["region right was failed; its content is not trusted"],
        ),
        (
            {"mode": "slow", "regions": HELD | {"right": RegionState(CUT, "fft", "f2")}},  # of no use to that mode
            None,
            {},
            {"regions": lost("right")},
            ["region right was decoupled; its content is not trusted"],
        ),
        (
            {"static_lost": True},
            None,
            {"cells": {0x1010: 8}},
            {},
            ["a load of a full image did not end well; nothing in the device is accessed"],
        ),
    ],
)
def test_what_a_step_that_was_cut_short_may_have_touched_is_not_trusted(
    before: dict[str, Any], cut: Pending | None, there: dict[str, Any], change: dict[str, Any], notes: list[str]
) -> None:
    state = replace(BOTH, **before)
    finding, board = found(state, cut, **there)
    assert list(finding.notes) == notes
    assert finding.state == replace(state, **change)
    assert ("extra" in board.overlays_on) is bool(state.overlays)


def test_what_was_cut_short_is_undone_with_what_there_was_before_it() -> None:
    cut = changing("load", "right", values={"led": 6}, found=((0x1040, 32, 9),), rates={"fclk0": 50})
    finding, _ = found(replace(BOTH, regions=lost("right"), mode="slow"), cut, cells={0x1010: 8, 0x101C: 4})
    assert finding.interrupted is not None
    assert finding.interrupted.values == {"led": 8, "gain": 7}  # as they read; it has written `tone` itself
    since, _ = found(replace(BOTH, regions=lost("right"), mode="slow"), cut, cells={0x101C: 2})
    assert since.interrupted is not None
    assert since.interrupted.values["tone"] == 2  # it writes 4: somebody wrote this after the board had gone back
    same, _ = found(BOTH, replace(cut, values={"tone": 4}), cells={0x101C: 2})
    assert same.interrupted is not None
    assert same.interrupted.values["tone"] == 2  # which it had no need to write: somebody else did
    there = destination(finding.state, finding.interrupted, {"lab": LAB})
    assert there == Destination(LAB, "slow")
    change = repair(12, there, finding.interrupted, finding.state)
    assert (change.number, change.config, change.mode, change.static) == (12, "lab", "slow", None)
    assert (change.also, change.found, change.rates) == (("fft",), {(0x1040, 32): 9}, {"fclk0": 50})
    assert change.values == {"led": 8, "gain": 7, "tone": 0}
    again = repair(13, replace(there, static="whole"), None, finding.state)
    assert (again.also, again.found, again.values, again.static) == ((), {}, finding.state.values, "whole")


@pytest.mark.parametrize(
    ("change", "whole"),
    [
        ({}, True),
        ({"clocks": {}}, False),
        ({"regions": lost("right")}, False),
        ({"regions": lost("right"), "mode": "slow"}, True),
    ],
)
def test_a_board_is_whole_where_each_region_of_its_mode_is_ready_and_its_clocks_are_known(
    change: dict[str, Any], whole: bool
) -> None:
    state = replace(BOTH, **change)
    assert is_whole(state, Destination(LAB, state.mode or "")) is whole


# ---- the state table ---------------------------------------------------------------------------


@pytest.mark.parametrize("phase", list(RegionPhase))
@pytest.mark.parametrize("event", list(RegionEvent))
def test_an_event_keeps_what_a_region_holds_or_forgets_it_and_others_are_defects(
    phase: RegionPhase, event: RegionEvent
) -> None:
    before = RegionState(phase, "fir", "f1")
    there = TRANSITIONS.get((phase, event))
    if there is None:
        with pytest.raises(IllegalTransition) as refused:
            before.after(event)
        assert str(refused.value) == f"region in phase {phase.value} cannot {event.value}"
        return
    forgets = event in (RegionEvent.LOAD, RegionEvent.LOAD_FAILED, RegionEvent.LOSE)
    recovers = phase is RegionPhase.FAILED and event is RegionEvent.DECOUPLE
    assert before.after(event) == (RegionState(there) if forgets or recovers else replace(before, phase=there))


def test_values_that_were_written_since_are_those_of_the_same_configuration() -> None:
    now = replace(BOTH, values={"led": 6, "gain": 7, "tone": 1, "new": 2})
    assert now.values_since(BOTH, but=("tone",)) == {"led": 6, "new": 2}
    assert now.values_since(replace(BOTH, config="other"), but=()) == {}
    assert now.without_values({"led", "none"}).values == {"gain": 7, "tone": 1, "new": 2}
    assert now.with_clock("fclk1", 5).clocks == {"fclk0": 99, "fclk1": 5}


@pytest.mark.parametrize(
    ("change", "after"),
    [
        ({}, replace(BOTH, regions=lost("left", "right"), values={})),  # what the boot loader put there
        (
            {"static_sha256": "w", "static_config": "whole"},
            BoardState(regions=lost("left", "right"), overlays=BOTH.overlays, clocks=BOTH.clocks, static_lost=True),
        ),
        (
            {"static_lost": True},
            BoardState(regions=lost("left", "right"), overlays=BOTH.overlays, clocks=BOTH.clocks, static_lost=True),
        ),
    ],
)
def test_after_a_sleep_only_what_the_kernel_keeps_is_known(change: dict[str, Any], after: BoardState) -> None:
    assert slept(replace(BOTH, **change)) == after
