# SPDX-License-Identifier: Apache-2.0
"""The steps from what the board holds to a goal: no board, no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import pytest

from cm.errors import CmError
from cm.hashes import sha256
from cm.manager.errors import ClockRate, StaticUnknown, StepTimeout
from cm.manager.inputs import Image
from cm.manager.planner import Goal, Plan, make_plan
from cm.manager.state.board_state import BoardState, OverlayState, RegionPhase, RegionState
from cm.manager.state.journal import Throughput
from cm.manager.state.steps import Load, LoadStatic, Recouple, SetClock, SetRegister
from cm.schema import loads
from cm.schema.model import LoaderKind
from cm.wire.messages.status import ClockStatus, PlanStep

LAB = loads("""
config:
  name: lab
  regions: {left: {timeout: 9}, right: {loader: overlay}}
  modules:
    fir:
      region: left
      registers: {ctrl: {base_address: 0x2000, offset: 0, fields: {start: {bits: 0}, auto_restart: {bits: 7}}}}
    iir: {region: left}
    fft: {region: right}
    dct: {region: right}
  overlays: [base]
  clocks: {fclk0: 100_000_000, fclk1: {rate: 50_000_000, tolerance: 10}}
  mmio:
    - base_address: 0x1000
      registers:
        led: {offset: 0x10, default: 3}
        tone: {offset: 0x14}
        ident: {offset: 0x18, access: ro}
        flags: {offset: 0x1c, access: w1c}
    - {base_address: 0x2000, region: left, registers: {gain: {offset: 0x20, default: 1}}}
    - {base_address: 0x3000, region: right, registers: {depth: {offset: 0x20, default: 2}}}
  streams: {through: {direction: s2mm, region: left, shape: [4]}, other: {direction: s2mm, region: right, shape: [4]}}
  modes:
    one: {modules: [fir], registers: {lamp: {base_address: 0x1000, offset: 0x40, default: 5}}}
    two: {modules: [iir]}
    both: {modules: [iir, dct], overlays: [extra]}
    once: {modules: [fir], run: once}
    on: {modules: [fir], run: continuous}
""")
WHOLE = loads("""
config:
  name: whole
  type: full
  timeout: 8
  static: {identity: 7, base_address: 0x9000}
  regions: {left: {identity: {base_address: 0x2000, offset: 0x40}}}
  modules: {w: {region: left, identity: 5}}
  modes: {bare: {}, full: {modules: [w]}}
""")
READY = RegionPhase.READY
REGIONS_BOTH = {"left": RegionState(READY, "iir", "iir"), "right": RegionState(READY, "dct", "dct")}
HELD = {"left": RegionState(READY, "fir", "fir"), "right": RegionState(READY, "fft", "fft")}


def on(name: str) -> OverlayState:
    return OverlayState(name, sha256(name.encode()))


ONE = BoardState(
    "lab",
    "one",
    regions=HELD,
    overlays=(OverlayState("cm-right", "fft"), on("base")),
    values={"led": 3, "lamp": 5, "gain": 1, "depth": 2},
    clocks={"fclk0": 99_999_999, "fclk1": 50_000_000},
)


class Clock:
    def __init__(self, rate: int, enabled: bool = True) -> None:
        self.rate, self.enabled = rate, enabled

    def rounded(self, hertz: int) -> int | None:
        return next((rate for rate in (99_999_999, 90_909_090) if 0 <= hertz - rate < 7_000_000), hertz)


class Blind(Clock):
    """One whose driver does not say beforehand what it will make of a rate."""

    def rounded(self, hertz: int) -> int | None:
        return None


def image(name: str) -> Image:
    return Image(Path(f"{name}.bit"), name, 4000, None, True, False)


def plan(
    goal: Goal,
    state: BoardState = ONE,
    clocks: Mapping[str, Clock] | None = None,
    old: Any = LAB,
    design: bool = True,
    throughput: Throughput = Throughput(),  # noqa: B008
) -> Plan:
    files: Any = SimpleNamespace(
        image=lambda config, module: image(module.name),
        static_image=lambda config: image(config.name),
        overlay=lambda config, overlay, images: overlay.name.encode(),
        loading_overlay=lambda config, module, made: f"{module.name} {made.path}".encode(),
    )
    if clocks is None:
        clocks = {"fclk0": Clock(99_999_999), "fclk1": Clock(50_000_000)}
    devices: Any = SimpleNamespace(
        clocks=lambda: SimpleNamespace(names=lambda: [*clocks], find=clocks.__getitem__), holds_design=lambda: design
    )
    return make_plan(goal, state, old, files, throughput, devices)


def test_a_pl_that_may_be_empty_is_not_touched_before_something_was_loaded() -> None:
    with pytest.raises(StaticUnknown, match=r"an access of an empty PL stalls the board\. Load the image first"):
        plan(Goal(LAB, "two"), BoardState(), old=None, design=False)
    assert texts(plan(Goal(LAB, "two"), BoardState(), old=None, design=True))
    assert texts(plan(Goal(LAB, "two"), ONE, design=False))  # this manager loaded it since the board was started


def texts(made: Plan) -> list[str]:
    """All steps but what every plan begins and ends with."""
    steps = [step.text for step in (*made.steps, *made.then)]
    if steps:
        goal = f"{made.goal.config.name}/{made.goal.mode}"
        assert (steps[0].startswith("check "), steps[-1]) == (True, f"publish {goal} and start its streams")
    return [text for text in steps[1:-1] if not text.startswith("assume the static part of")]


def board(**change: Any) -> BoardState:
    return replace(ONE, **change)


STOP, CUT = "stop streams through", "decouple left (it has no decoupler)"
STOP_ALL, CUT_RIGHT = "stop streams through, other", "decouple right (it has no decoupler)"
JOINED = ["recouple left", "set gain = 0x1", "set lamp = 0x5"]
LOAD_FIR = [STOP, CUT, "load fir into left by icap", *JOINED]
ANEW = ["remove overlay base", "remove overlay cm-right", "apply overlay base"]
BOTH_JOINED = ["recouple left", "recouple right", "set gain = 0x1", "set depth = 0x2"]
CLOCK0 = "set clock fclk0 to 100 MHz, which makes 99.999999 MHz (now 99.999999 MHz)"


def left(phase: RegionPhase) -> BoardState:
    return board(regions=HELD | {"left": RegionState(phase, "fir", "fir")})


@pytest.mark.parametrize(
    ("goal", "state", "steps"),
    [
        (Goal(LAB, "one"), ONE, []),
        (Goal(LAB, "two"), ONE, [STOP, CUT, "load iir into left by icap", *JOINED[:2]]),
        (
            Goal(LAB, "both"),
            ONE,
            [
                STOP_ALL,
                *ANEW,
                CUT,
                CUT_RIGHT,
                "load iir into left by icap",
                "load dct into right by overlay",
                "apply overlay extra",
                *BOTH_JOINED,
            ],
        ),
        # registers
        (Goal(LAB, "one"), board(values={**ONE.values, "led": 4}), ["set led = 0x3"]),
        (Goal(LAB, "one"), board(values={}), ["set led = 0x3", "set gain = 0x1", "set depth = 0x2", "set lamp = 0x5"]),
        (Goal(LAB, "one", values={"led": 9, "ident": 1, "flags": 1}), ONE, ["set led = 0x9"]),
        (
            Goal(LAB, "one", found={(0x1010, 32): 8, (0x1014, 32): 3, (0x5000, 8): 6}),
            ONE,
            ["set at 0x5000 = 0x6", "set led = 0x8", "set tone = 0x3"],
        ),
        (Goal(LAB, "one"), board(mode="two"), []),
        (Goal(LAB, "once"), ONE, ["set ctrl = 0x1"]),
        (Goal(LAB, "once"), board(mode="once", values={**ONE.values, "ctrl": 1}), []),
        (Goal(LAB, "on"), ONE, ["set ctrl = 0x81"]),
        (Goal(LAB, "on"), board(values={**ONE.values, "ctrl": 0x81}), []),
        # regions
        (Goal(LAB, "one", reload=("left",)), ONE, LOAD_FIR),
        (Goal(LAB, "one"), left(RegionPhase.DECOUPLED), [STOP, *JOINED]),
        (Goal(LAB, "one"), left(RegionPhase.LOADED), [STOP, *JOINED]),
        (Goal(LAB, "one"), left(RegionPhase.FAILED), LOAD_FIR),
        (Goal(LAB, "one"), left(RegionPhase.UNKNOWN), LOAD_FIR),
        (
            Goal(LAB, "one"),
            board(regions=HELD | {"right": RegionState()}, values={}),  # where nobody answers
            ["set led = 0x3", "set gain = 0x1", "set lamp = 0x5"],
        ),
        (
            Goal(LAB, "two", also=("fft",)),
            board(regions=HELD | {"right": RegionState()}, mode="two"),
            [
                STOP_ALL,
                *ANEW,
                CUT,
                CUT_RIGHT,
                "load iir into left by icap",
                "load fft into right by overlay",
                *BOTH_JOINED,
            ],
        ),
        # overlays
        (Goal(LAB, "one"), board(overlays=ONE.overlays[:1]), [STOP_ALL, "apply overlay base"]),
        (Goal(LAB, "one", grounded=True), board(overlays=ONE.overlays[:1]), ["apply overlay base"]),
        (Goal(LAB, "one"), board(overlays=(*ONE.overlays, on("extra"))), ["remove overlay extra"]),
        (
            Goal(LAB, "one"),
            board(overlays=(ONE.overlays[0], OverlayState("base", "old"))),
            [STOP_ALL, "remove overlay base", "apply overlay base"],
        ),
        (  # what lies on one that goes, goes first
            Goal(LAB, "both", grounded=True),
            board(mode="both", regions=REGIONS_BOTH, overlays=(OverlayState("x", ""), on("base"), on("extra"))),
            [
                "stop streams other",
                "remove overlay extra",
                "remove overlay base",
                "remove overlay x",
                CUT_RIGHT,
                "load dct into right by overlay",
                "apply overlay base",
                "apply overlay extra",
                "recouple right",
                "set depth = 0x2",
            ],
        ),
        # clocks
        (Goal(LAB, "one"), board(clocks={}), [CLOCK0, "set clock fclk1 to 50 MHz (now 50 MHz)"]),
        (
            Goal(LAB, "two"),
            board(clocks={"fclk1": 50_000_000}),
            [STOP, CUT, CLOCK0, "load iir into left by icap", *JOINED[:2]],
        ),
        (Goal(LAB, "one", rates={"fclk0": 33_000_000}), ONE, ["set clock fclk0 to 33 MHz (now 99.999999 MHz)"]),
    ],
)
def test_only_what_differs_is_done_and_in_its_order(goal: Goal, state: BoardState, steps: list[str]) -> None:
    assert texts(plan(goal, state)) == steps


def test_a_change_of_streams_alone_stops_those_that_look_different() -> None:
    wide = replace(LAB.streams["other"], shape=(8,))
    modes = {**LAB.modes, "one": replace(LAB.modes["one"], streams={**LAB.modes["one"].streams, "other": wide})}
    other = replace(LAB, modes=MappingProxyType(modes))
    state = board(mode="on", values={**ONE.values, "ctrl": 0x81})
    assert texts(plan(Goal(other, "one"), state, old=other)) == ["stop streams other"]
    assert texts(plan(Goal(LAB, "one"), board(mode=None, values={}), old=LAB))[0] == "set led = 0x3"
    assert texts(plan(Goal(LAB, "one"), board(config="gone", values={}), old=None))[0] == "set led = 0x3"


@pytest.mark.parametrize(
    ("clocks", "steps"),
    [
        ({}, []),
        ({"fclk1": Clock(50_000_000, enabled=False)}, ["set clock fclk1 to 50 MHz (now 50 MHz)"]),
        ({"fclk0": Clock(99_999_998)}, ["set clock fclk0 to 100 MHz, which makes 99.999999 MHz (now 99.999998 MHz)"]),
        ({"fclk0": Blind(98_999_999)}, ["set clock fclk0 to 100 MHz (now 98.999999 MHz)"]),
        ({"fclk1": Blind(50_000_000)}, []),
    ],
)
def test_a_clock_is_set_unless_it_runs_as_it_was_set(clocks: dict[str, Clock], steps: list[str]) -> None:
    there = {"fclk0": Clock(99_999_999), "fclk1": Clock(50_000_000)} | clocks
    rates = {name: 99_999_999 if name == "fclk0" else 50_000_000 for name in there}
    assert texts(plan(Goal(LAB, "one"), board(clocks=rates), there)) == steps


def test_clocks_that_nothing_sets_are_told_once_and_a_rate_that_cannot_be_is_refused() -> None:
    unset = plan(Goal(LAB, "one"), ONE, {})
    assert texts(unset)[0] == "leave clock fclk0 as it is: 100 MHz is wanted, no driver here sets it"
    assert unset.info(Throughput()).clocks == (ClockStatus("fclk0", 100_000_000), ClockStatus("fclk1", 50_000_000))
    assert texts(plan(Goal(LAB, "one"), board(clocks={"fclk0": 0, "fclk1": 0}), {})) == []
    far = replace(LAB, clocks={**LAB.clocks, "fclk0": replace(LAB.clocks["fclk0"], rate=97_000_000)})
    with pytest.raises(ClockRate, match=r"clock fclk0 would run at 90\.90909 MHz"):
        plan(Goal(far, "one"), board(clocks={}))
    assert texts(plan(Goal(far, "one", rates={"fclk0": 97_000_000}), board())) == [  # on a way back
        "set clock fclk0 to 97 MHz, which makes 90.90909 MHz (now 99.999999 MHz)"
    ]


@pytest.mark.parametrize(
    ("goal", "state", "steps"),
    [
        (
            Goal(WHOLE, "bare"),
            board(static_sha256="whole"),  # whatever else is in it
            [STOP_ALL, *ANEW[:2], "load the whole device from whole.bit by fpga_manager"],
        ),
        (
            Goal(WHOLE, "full"),
            ONE,
            [
                STOP_ALL,
                *ANEW[:2],
                "load the whole device from whole.bit by fpga_manager",
                "check that the static part is 0x7",
                CUT,
                "load w into left by icap",
                "recouple left",
                "check that left holds w",
            ],
        ),
        (Goal(WHOLE, "bare"), BoardState("whole", "bare", static_sha256="whole"), []),
        (Goal(WHOLE, "bare"), BoardState("whole", "full", static_sha256="whole"), []),
        (
            Goal(WHOLE, "bare"),
            BoardState("whole", "bare", static_sha256="before it was built anew"),
            ["load the whole device from whole.bit by fpga_manager"],
        ),
        (
            Goal(WHOLE, "bare"),
            BoardState("whole", "bare", static_sha256="whole", static_lost=True),
            ["load the whole device from whole.bit by fpga_manager"],
        ),
        (
            Goal(WHOLE, "bare", force=True),
            BoardState("whole", "bare", static_sha256="whole"),
            ["load the whole device from whole.bit by fpga_manager"],
        ),
        (Goal(WHOLE, "bare", grounded=True), BoardState("whole", "bare", static_sha256="other"), []),
    ],
)
def test_an_image_of_the_whole_device_is_loaded_where_it_is_not_there(
    goal: Goal, state: BoardState, steps: list[str]
) -> None:
    made = plan(goal, state)
    loads_it = any("whole device" in text for text in steps)
    full = [step for step in made.steps if isinstance(step, LoadStatic)]
    assert (made.full, len(full)) == (loads_it, int(loads_it))
    assert ("whole.bit" in "".join(step.text for step in made.steps[:1])) is loads_it
    assert texts(made) == steps
    assert not full or (full[0].timeout, full[0].config, full[0].loader) == (8.0, "whole", LoaderKind.FPGA_MANAGER)


def test_a_partial_configuration_goes_back_to_the_image_that_it_ran_on() -> None:
    made = plan(Goal(LAB, "two", static=WHOLE), BoardState(), old=None)
    assert made.full
    assert texts(made)[:4] == [
        "set clock fclk0 to 100 MHz, which makes 99.999999 MHz (now 99.999999 MHz)",
        "set clock fclk1 to 50 MHz (now 50 MHz)",
        "load the whole device from whole.bit by fpga_manager",
        "apply overlay base",
    ]
    unhurried = replace(WHOLE, timeout=None)
    (full,) = [step for step in plan(Goal(unhurried, "bare"), ONE).steps if isinstance(step, LoadStatic)]
    assert full.timeout == 2.0 + 20.0 * 4000 / 145e6
    with pytest.raises(CmError) as refused:
        plan(Goal(LAB, "two"), BoardState(static_lost=True))
    assert str(refused.value) == (
        "the load of a full image failed, so it is unknown what the device holds; lab is partial and needs its static "
        "part: load a full configuration, or restart the board"
    )


def test_a_time_out_that_the_port_as_measured_cannot_meet_is_told_before_the_first_step() -> None:
    slow, quick = (Throughput(MappingProxyType({LoaderKind.ICAP: (rate, rate)})) for rate in (400.0, 500.0))
    with pytest.raises(StepTimeout) as refused:
        plan(Goal(LAB, "two"), throughput=slow)
    assert str(refused.value) == (
        "lab: timeout: 9 s of left is too short for iir.bit: 4000 bytes take 10 s by icap, as measured here"
    )
    assert plan(Goal(LAB, "two"), throughput=quick).bytes == 4000


def test_steps_carry_what_their_actions_need() -> None:
    made = plan(Goal(LAB, "both", grounded=True))
    left, right = [step for step in made.steps if isinstance(step, Load)]
    assert (left.timeout, left.overlay, left.image) == (9.0, b"", image("iir"))
    assert (right.timeout, right.overlay) == (2.0 + 20.0 * 4000 / 145e6, b"dct dct.bit")
    first, second = [step for step in made.steps if isinstance(step, Recouple)]
    assert first.resets == {"ctrl", "gain", "lamp"}
    assert second.resets == {"depth"}
    assert (made.bytes, made.regions, made.full) == (8000, {"left", "right"}, False)
    known = Throughput().took(("load", 0.5), ("publish", 0.25)).observed(LoaderKind.ICAP, 4000, 1.0)
    told = made.info(known.observed(LoaderKind.ICAP, 4000, 1.0))
    assert (told.config_name, told.mode, told.bytes, told.clocks) == ("lab", "both", 8000, ())
    assert told.seconds == pytest.approx(1.0 + 2 * 0.5 + 0.25 + 4000 / 145e6)
    assert told.steps[-1] == PlanStep("publish", "lab/both", "publish lab/both and start its streams", 0, 0.25)
    assert next(x for x in told.steps if x.kind == "load") == PlanStep("load", "left", left.text, 4000, 1.5)
    again = plan(Goal(LAB, "once", found={(0x5000, 8): 6}))
    restored, control = [step for step in again.steps if isinstance(step, SetRegister)]
    assert (restored.restores, restored.register.address, restored.register.width) == (True, 0x5000, 8)
    assert (control.restores, control.register.volatile) == (False, True)
    back = plan(Goal(LAB, "one", rates={"fclk0": 33_000_000}))
    (clock,) = [step for step in back.steps if isinstance(step, SetClock)]
    assert (clock.restores, clock.before, clock.achieved, clock.running) == (True, 99_999_999, 33_000_000, True)
    grounds = plan(Goal(LAB, "one"), board(overlays=ONE.overlays[:1]))
    assert [step.text for step in grounds.steps][-1] == "apply overlay base"
    assert [step.text for step in grounds.then] == ["publish lab/one and start its streams"]
