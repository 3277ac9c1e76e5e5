# SPDX-License-Identifier: Apache-2.0
"""What is told of configurations, regions and changes: no board."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from cm.manager.state.board_state import BoardState, RegionPhase, RegionState
from cm.manager.state.journal import ManagerState
from cm.manager.state.steps import Choice
from cm.manager.status_reports import (
    Health,
    StatusReporter,
    clock_states,
    config_info,
    config_list,
    is_long,
    memory_info,
    region_states,
)
from cm.schema import loads
from cm.schema.model import Config, LoaderKind
from cm.wire.messages.status import (
    ClockStatus,
    ConfigEntry,
    ConfigInfo,
    ErrorInfo,
    FieldInfo,
    FrameError,
    InterruptInfo,
    MemoryInfo,
    ModeInfo,
    PrMode,
    Progress,
    RegionCheck,
    RegionHealth,
    RegionMap,
    RegionStatus,
    RegisterInfo,
    StreamStatus,
)

LAB = loads("""
config:
  name: lab
  type: full
  default_mode: two
  regions: {left: {loader: auto}, right: {}}
  modules: {fir: {region: left}, fft: {region: right}}
  overlays: [base]
  clocks: {fclk0: 100_000_000, fclk1: 50_000_000}
  mmio:
    - base_address: 0x1000
      registers:
        light:
          {offset: 0x14, width: 16, default: 1, min: 1, max: 9, doc: a light, fields: {
            on: {bits: 0, doc: whether, access: w1s}, colour: {bits: "3:1", values: {off: 0, red: 4}}}}
    - base_address: 0x2000
      region: left
      memories: {taps: {size: 64, access: ro, dtype: int16, shape: [4, 8], doc: t}}
  interrupts: {done: {uio: done, doc: at last}, other: {uio: other}}
  streams:
    camera: {direction: s2mm, region: left, shape: [4, 8, 3], dtype: uint8, slots: 5, stride: 32, limit: 2.5,
      cyclic: true, backpressure: true, format: bgr}
    plain: {direction: mm2s}
  modes:
    one:
      modules: [fir]
      registers: {lamp: {base_address: 0x1000, offset: 0x40, access: ro}}
      memories: {log: {base_address: 0x5000, size: 32}}
    two: {modules: [fir, fft], overlays: [extra]}
""")


def test_a_configuration_is_described_whole() -> None:
    told = config_info(LAB, "two", {"done": 3}, "text", {})
    light = RegisterInfo(
        "light", 0x1014, 16, "rw", 1, 1, 9, "a light",
        (FieldInfo("on", 0, 1, "whether", (), "w1s"), FieldInfo("colour", 1, 3, "", (("off", 0), ("red", 4)), "")),
    )  # fmt: skip
    camera = StreamStatus(
        "camera",
        LAB.streams["camera"].channel,
        "s2mm",
        (4, 8, 3),
        "uint8",
        5,
        cyclic=True,
        backpressure=True,
        stride=32,
        limit=2.5,
        format="bgr",
    )
    assert told == ConfigInfo(
        "lab",
        "full",
        "two",
        (
            ModeInfo("one", ("fir",), ("light", "lamp"), ("base",)),
            ModeInfo("two", ("fir", "fft"), ("light",), ("base", "extra")),
        ),
        (light, RegisterInfo("lamp", 0x1040, 32, "ro", modes=("one",), region="left")),
        (InterruptInfo("done", "at last", 3), InterruptInfo("other", "", 0)),
        (camera, StreamStatus("plain", LAB.streams["plain"].channel, "mm2s", slots=LAB.streams["plain"].slots)),
        schema="text",
        memories=(
            MemoryInfo("taps", 0x2000, 64, "ro", "int16", (4, 8), "left", "t"),
            MemoryInfo("log", 0x5000, 32, region="left", modes=("one",)),
        ),
    )  # fmt: skip
    unloaded = config_info(LAB, "", {}, "", {})
    assert (unloaded.mode, unloaded.streams) == ("", told.streams)
    assert memory_info(LAB.memories["taps"], defined=True).defined


def test_things_of_one_name_in_two_modules_are_described_each_with_its_modes() -> None:
    config = loads("""
config:
  name: lab
  modules:
    a: {mmio: [{base_address: 0x1000, registers: {gain: {offset: 0}, on: {offset: 4}}}]}
    b: {mmio: [{base_address: 0x1000, registers: {gain: {offset: 8, default: 1}, on: {offset: 4, default: 1}}}]}
  modes: {one: {modules: [a]}, two: {modules: [b]}, three: {modules: [b]}}
""")
    told = [(r.name, r.address, r.modes) for r in config_info(config, "two", {}, "", {}).registers]
    assert told == [("gain", 0x1000, ("one",)), ("gain", 0x1008, ("two", "three")), ("on", 0x1004, ())]


def test_all_configurations_are_listed_by_name_with_their_modes() -> None:
    plain = loads("config: {name: plain, modes: {only: {}}}\n")
    entries = ConfigEntry("lab", "full", ("one", "two"), "two"), ConfigEntry("plain", "partial", ("only",), "only")
    assert config_list({"plain": plain, "lab": LAB}) == ConfigInfo(names=("lab", "plain"), entries=entries)


def many(count: int, where: str) -> Config:
    registers = ", ".join(f"r{number}: {{base_address: 0x1000, offset: {4 * number}}}" for number in range(count))
    texts = {
        "top": "config: {name: x, registers: R, modes: {m: {}}}\n",
        "module": "config: {name: x, modules: {a: {registers: R}}, modes: {m: {modules: [a]}}}\n",
        "mode": "config: {name: x, modes: {m: {registers: R}}}\n",
    }
    return loads(texts[where].replace("R", f"{{{registers}}}"))


def test_a_configuration_is_long_to_describe_beyond_two_hundred_registers_wherever_they_are() -> None:
    assert [is_long(many(count, "top")) for count in (200, 201)] == [False, True]
    assert [is_long(many(201, where)) for where in ("module", "mode")] == [True, True]
    assert not is_long(None)


def test_regions_of_the_configuration_come_first_with_the_port_that_was_chosen() -> None:
    held = {"old": RegionState(RegionPhase.FAILED, "x", "y"), "left": RegionState(RegionPhase.READY, "fir", "1")}
    health = {"left": RegionHealth(checks=2)}
    choices = {("lab", "left"): Choice(LoaderKind.FPGA_MANAGER, "no icap"), ("else", "right"): Choice(LoaderKind.ICAP)}
    assert region_states(LAB, held, choices, health) == (
        RegionStatus("left", "fir", "ready", "fpga_manager (no icap)", health["left"]),
        RegionStatus("right", None, "unknown"),
        RegionStatus("old", "x", "failed"),
    )
    assert region_states(LAB, {}, {("lab", "right"): Choice(LoaderKind.ICAP)}, {})[1].loader == "icap"
    assert region_states(None, held, choices, health) == (
        RegionStatus("old", "x", "failed"),
        RegionStatus("left", "fir", "ready", "", health["left"]),
    )
    told = ClockStatus("fclk0", 100_000_000, 99), ClockStatus("fclk1", 50_000_000, 0)
    assert (clock_states(LAB, {"fclk0": 99, "other": 5}), clock_states(None, {"fclk0": 99})) == (told, ())


def told(health: Health) -> dict[str, RegionHealth]:
    """As it is told, with 1 for the time of a check."""
    return {name: replace(one, checked_ns=min(one.checked_ns, 1)) for name, one in health.told.items()}


def test_what_is_wrong_in_a_region_is_counted_once_until_it_is_mended() -> None:
    health, column = Health(), RegionMap("left", "fir", "xc7z020", "lab")
    frames = (FrameError(1, 0, 0, 0, 0, (3,)),)
    left, right = RegionCheck("left", "fir", "wrong", 90, 10, wrong=frames), RegionCheck("right", "fft", "good", 5)
    health.mended("left")
    assert (health.told, health.on(column)) == ({}, column)
    for wrong in ({(1, 2), (1, 3)}, {(1, 3), (2, 0)}):
        health.checked(left, frozenset(wrong))
    assert told(health) == {"left": RegionHealth(2, 3, 0, 2, 90, 10, 1)}
    drawn = health.on(column)
    assert (drawn.wrong, 0 < drawn.checked < 60) == (frames, True)
    health.repaired("left")
    health.mended("left")
    assert health.on(column) == column  # what is there now was not compared yet
    health.checked(right, frozenset())
    assert told(health) == {"left": RegionHealth(2, 3, 1, 0, 90, 10), "right": RegionHealth(1, frames=5, checked_ns=1)}
    health.checked(left, frozenset({(1, 3)}))
    assert told(health)["left"] == RegionHealth(3, 4, 1, 1, 90, 10, 1)


def test_the_status_tells_of_a_change_from_its_beginning_to_its_end() -> None:
    told: list[str] = []
    observer: Any = SimpleNamespace(
        status_changed=lambda: told.append("status"), progressed=lambda: told.append("step")
    )
    journal: Any = None
    state = ManagerState({"lab": LAB}, journal)
    reporter = StatusReporter(state, observer)

    def now() -> tuple[bool, PrMode, Progress | None, ErrorInfo | None]:
        status = reporter.status()
        return status.fpga_busy, status.pr_mode, status.progress, status.last_error

    assert (now(), reporter.status().last_change) == ((False, PrMode.IDLE, None, None), 0)
    for full, kind in ((False, PrMode.PARTIAL), (True, PrMode.FULL)):
        reporter.begun(4, "lab", "two", full)
        assert now() == (True, kind, Progress(4, "lab", "two", "validate"), None)
    broken, full_disk, found = ErrorInfo("load_failed", "it"), ErrorInfo("store", "disk"), ErrorInfo("reconciled", "so")
    reporter.ended(4, broken, 1.5)
    assert now() == (False, PrMode.ERROR, None, broken)
    reporter.note(full_disk)
    assert now()[3] == broken  # which is of more use
    reporter.begun(5, "lab", "two", False)
    reporter.ended(5, ErrorInfo("cancelled", "so"), 2.5)
    assert now()[:2] == (False, PrMode.IDLE)
    reporter.ended(6, None, 2.5)
    reporter.note(full_disk)
    assert now() == (False, PrMode.IDLE, None, full_disk)
    reporter.set_notice(found)
    assert now() == (False, PrMode.IDLE, None, found)
    reporter.set_error(broken)
    assert now() == (False, PrMode.IDLE, None, broken)  # of a request
    reporter.was_read()  # but not the notice
    reporter.ended(7, None, 0.5)
    assert now()[3] == found
    reporter.was_read()
    assert now()[3] == found
    reporter.ended(8, None, 0.5)
    assert now()[3] is None
    reporter.set_error(broken, failed=True)
    reporter.set_error(full_disk)
    assert now() == (False, PrMode.ERROR, None, full_disk)
    reporter.changed()
    assert told == ["step", "step", "step", "status"]
    state.update(lambda _: BoardState("lab", "two", clocks={"fclk0": 99}))
    status = reporter.status(streams=(), sequence=9)
    assert (status.config_name, status.mode, status.configs, status.sequence) == ("lab", "two", ("lab",), 9)
    assert (status.last_change, status.last_change_seconds, status.generation) == (8, 0.5, 0)
    assert [clock.rate for clock in status.clocks] == [99, 0]
    assert [region.name for region in status.regions] == ["left", "right"]
