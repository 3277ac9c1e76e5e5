# SPDX-License-Identifier: Apache-2.0
"""Clocks of a configuration: set, read back, reported, refused if impossible, and undone."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from manager_support import Rig, killed_at, rig

from cm.device import DeviceError, DeviceNotFound, PlClocks
from cm.schema import dump, load, loads
from cm.schema.clock_rates import PLL, rounded
from cm.schema.model import Clock, Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode
from cm.wire.messages.status import ClockStatus

BOOT = 49_999_999  # Hz, as set by the simulated boot loader
FAST = 142_857_141  # the nearest rate of the dividers to 142.86 MHz

TEXT = """
config:
  name: {name}
  type: {type}
  device: xc7z020
  regions:
    prr0: {{decoupler: {{base_address: 0x1000, offset: 0x0}}}}
  modules:
    {name}_a: {{region: prr0}}
  clocks: {clocks}
  modes:
    default: {{modules: [{name}_a]}}
"""
CLOCKS = {
    "slow": ("partial", "{}"),
    "fast": ("partial", "{fclk0: {rate: 142_860_000}, fclk1: 100_000_000}"),
    "odd": ("partial", "{fclk0: 97_000_000}"),
    "below": ("partial", "{fclk0: 142_857_132, fclk1: 99_999_001}"),  # as Vivado writes them
    "lax": ("partial", "{fclk0: {rate: 97_000_000, tolerance: 10}}"),
}


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    folder = tmp_path_factory.mktemp("clocks")
    for name, (kind, clocks) in CLOCKS.items():
        (folder / f"{name}.yaml").write_text(TEXT.format(name=name, type=kind, clocks=clocks), encoding="utf-8")
    return {name: load(folder / f"{name}.yaml") for name in CLOCKS}


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config]) -> Iterator[SimBoard]:
    folder = configs["slow"].source
    assert folder is not None
    with SimBoard([folder.parent], arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    for name in sim.control.state()["clocks"]:
        PlClocks(sim.root).find(name).rate = 50_000_000
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started
        sim.control.clear()


def rates(sim: SimBoard) -> tuple[int, int]:
    """The rates of fclk0 and fclk1 on the board."""
    clocks = sim.control.state()["clocks"]
    return clocks["fclk0"], clocks["fclk1"]


def test_the_rates_are_planned_and_set_and_what_was_read_back_is_reported(made: Rig, sim: SimBoard) -> None:
    expected = (ClockStatus("fclk0", 142_860_000, FAST), ClockStatus("fclk1", 100_000_000, 99_999_999))
    assert made.manager.plan(ChangeMode("fast", "default")).clocks == expected
    assert rates(sim) == (BOOT, BOOT)
    assert made.go("default", config="fast") is None
    assert rates(sim) == (FAST, 99_999_999)
    assert made.manager.status().clocks == expected


def test_a_clock_that_was_changed_from_outside_is_set_again(made: Rig, sim: SimBoard) -> None:
    assert made.go("default", config="fast") is None
    clock = PlClocks(sim.root).find("fclk1")
    clock.rate, clock.enabled = 10_000_000, False
    assert [s.kind for s in made.manager.plan(ChangeMode(config_name="fast", mode="default")).steps] == [
        "validate",
        "clock",
        "publish",
    ]
    assert made.go("default", config="fast") is None
    assert (rates(sim), clock.enabled) == ((FAST, 99_999_999), True)


def test_an_impossible_rate_is_refused_before_anything_is_touched(made: Rig, sim: SimBoard) -> None:
    made.arm(-1)
    error = made.go("default", config="odd")
    assert error.code == "clock_rate"
    assert "clock fclk0 would run at 90.909" in error.message
    assert "1 % is allowed" in error.message
    assert rates(sim) == (BOOT, BOOT)
    assert "clock.write" not in made.fault.names
    assert "icap.load" not in made.fault.names
    assert made.go("default", config="lax") is None
    assert rates(sim)[0] == 90_909_090


def test_a_rate_just_below_one_that_the_dividers_make_is_that_one(made: Rig, sim: SimBoard) -> None:
    assert made.manager.plan(ChangeMode("below", "default")).clocks[0].rate == FAST
    assert made.go("default", config="below") is None
    assert rates(sim) == (FAST, 99_999_999)
    assert made.manager.plan(ChangeMode("below", "default")).steps == ()


def test_without_a_driver_clocks_stay_unchanged_and_that_is_reported_once(
    made: Rig, sim: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PlClocks, "names", lambda _: [])
    plan = made.manager.plan(ChangeMode(config_name="odd", mode="default"))
    assert "leave clock fclk0 as it is: 97 MHz is wanted, no driver here sets it" in [s.text for s in plan.steps]
    assert plan.clocks == (ClockStatus("fclk0", 97_000_000, 0),)
    assert made.go("default", config="odd") is None
    assert made.manager.status().clocks == plan.clocks
    assert rates(sim) == (BOOT, BOOT)
    assert made.manager.plan(ChangeMode(config_name="odd", mode="default")).steps == ()


def test_a_clock_that_ignores_its_rate_is_noticed_and_rolled_back(made: Rig, sim: SimBoard) -> None:
    assert made.go("default", config="slow") is None
    sim.control.inject("clock_stuck", "fclk0")
    error = made.go("default", config="fast")
    assert error.code == "clock_rate"
    assert "the board is back in slow/default" in error.message
    assert rates(sim) == (BOOT, BOOT)


@pytest.mark.parametrize("start", ["slow", ""])
def test_rates_are_undone_whichever_operation_fails(made: Rig, sim: SimBoard, start: str) -> None:
    """Also without a mode to go back to, and to the rates before a configuration without clocks."""
    number, failed = 0, 0
    while True:
        made.arm(-1)
        if start:
            assert made.go("default", config=start) is None
        before = rates(sim)
        made.arm(number)
        error = made.go("default", config="fast")
        made.arm(-1)
        if error is None:
            assert rates(sim) == (FAST, 99_999_999), number
            break
        assert rates(sim) == before == (BOOT, BOOT), f"{number}: {error}"
        failed += 1
        number += 1
    assert failed > 15


def test_a_clock_that_cannot_be_set_back_is_told(made: Rig, sim: SimBoard) -> None:
    loads: list[str] = []

    def fail(name: str) -> None:
        loads.extend([name] if name == "icap.load" else [])
        if name == "icap.load" or (loads and name == "clock.write"):
            raise DeviceError(errno.EIO, f"injected at {name}")

    made.fault.watch = fail
    error = made.go("default", config="fast")
    made.fault.watch = lambda _: None
    assert error.message == (
        "load fast_a into prr0 by icap: injected at icap.load; there was no mode to go back to; regions left "
        "decoupled: prr0; clock fclk0 could not be set back to 49.999999 MHz: injected at clock.write; "
        "clock fclk1 could not be set back to 49.999999 MHz: injected at clock.write"
    )
    assert rates(sim) == (FAST, 99_999_999)


@pytest.mark.parametrize("stride", [3])
def test_a_manager_that_is_killed_while_it_sets_clocks_brings_them_back(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path, stride: int
) -> None:
    assert made.go("default", config="slow") is None
    made.close()
    number, back = 0, 0
    while killed_at(sim.root, tmp_path, configs.values(), ("fast", "default"), number):
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            status = again.manager.status()
            if status.config_name == "slow":
                assert rates(sim) == (BOOT, BOOT), f"killed at {number}: {again.notes}"
                back += 1
            else:
                assert (status.config_name, rates(sim)) == ("fast", (FAST, 99_999_999))
                assert again.go("default", config="slow") is None
                for name in ("fclk0", "fclk1"):
                    PlClocks(sim.root).find(name).rate = 50_000_000
            assert sim.control.state()["regions"]["prr0"]["module"] == f"{again.manager.status().config_name}_a"
        number += stride
    assert back > 4


def test_rates_round_down_as_the_dividers_do() -> None:
    """Rates that the mainline driver derives from an IOPLL of 1 GHz; the lowest divides it by 63 twice."""
    pll = PLL["7series"]
    assert [rounded(pll, hz) for hz in (100_000_000, 142_860_000, 1, 10**12)] == [99_999_999, FAST, 251_952, pll]
    for wanted in range(1_000_000, 300_000_000, 7_654_321):
        assert rounded(pll, wanted) <= wanted


def test_a_clock_is_found_by_its_other_names_and_by_those_of_linux_xlnx(tmp_path: Path) -> None:
    folder = tmp_path / "sys/bus/platform/drivers/xilinx_fclk/axi:fclk1"
    folder.mkdir(parents=True)
    (folder / "set_rate").write_text("50000000\n", encoding="ascii")
    clocks = PlClocks(tmp_path)
    assert clocks.names() == ["fclk1"]
    for name in ("fclk1", "pl1", "pl_clk1", "clocking1"):
        assert clocks.find(name).rate == 50_000_000
    clock = clocks.find("pl1")
    clock.rate = 100_000_000
    assert (folder / "set_rate").read_text(encoding="ascii") == "100000000\n"
    assert clock.rounded(1) is None
    assert clock.enabled
    with pytest.raises(DeviceNotFound, match="there are fclk1"):
        clocks.find("pl0")


def test_the_tolerance_is_a_percentage_of_its_own_and_travels_with_the_schema(configs: dict[str, Config]) -> None:
    assert configs["fast"].clocks["fclk0"] == Clock("fclk0", 142_860_000, tolerance=1.0)
    half = replace(configs["lax"], clocks={"fclk0": Clock("fclk0", 10, tolerance=0.5)})
    assert loads(dump(half)).clocks["fclk0"].tolerance == 0.5
