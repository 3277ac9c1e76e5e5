# SPDX-License-Identifier: Apache-2.0
"""Regions that GPIO lines of the processor cut off, as PYNQ-PRIO's are: one by its place, one by its name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from manager_support import Rig, place_of, rig

from cm.device import GpioLine
from cm.schema import SchemaError, dump, load, loads
from cm.schema.model import Config, Decoupler
from cm.schema.model import GpioLine as Line
from cm.simulation.software import Board as SimBoard

TEXT = """
config:
  name: emio
  type: partial
  device: xc7z020
  regions:
    left: {decoupler: {gpio: {chip: zynq_gpio, line: 54}}}
    right: {decoupler: {gpio: {chip: zynq_gpio, line: right-cut}, active_high: false}}
  modules:
    a: {region: left}
    b: {region: left}
    c: {region: right}
    d: {region: right}
  modes:
    default: {modules: [a, c]}
    other: {modules: [b, d]}
"""


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Config:
    path = tmp_path_factory.mktemp("emio") / "emio.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return load(path)


@pytest.fixture(scope="module")
def sim(config: Config) -> Iterator[SimBoard]:
    assert config.source is not None
    with SimBoard([config.source], arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, config: Config, tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, config) as started:
        assert started.go("default", config="emio") is None
        yield started


def regions(sim: SimBoard) -> dict[str, tuple[str, bool]]:
    """Module, and whether it is cut off."""
    return {name: (r["module"], r["decoupled"]) for name, r in sim.control.state()["regions"].items()}


def test_a_region_is_cut_off_by_its_line_before_its_load(made: Rig, sim: SimBoard) -> None:
    seen: list[object] = []

    def watch(name: str) -> None:
        if name == "icap.load":
            seen.append([cut for _, cut in regions(sim).values()])

    made.arm(-1)
    made.fault.watch = watch
    assert made.go("other", config="emio") is None
    assert len(seen) == 2
    assert seen[0] == [True, True]
    assert regions(sim) == {"left": ("b", False), "right": ("d", False)}


def test_whichever_operation_fails_the_region_is_as_the_status_says(made: Rig, sim: SimBoard, config: Config) -> None:
    failed = set()
    for number in range(80):
        assert made.go("default", config="emio") is None
        made.arm(number)
        error = made.go("other", config="emio")
        made.fault.at = -1
        assert place_of(made, sim, {"emio": config}) == ("emio/default" if error else "emio/other"), (
            f"{number}: {error}"
        )
        if error is None and number >= len(made.fault.names):
            break
        failed.add(made.fault.names[number])
    else:
        pytest.fail("the walk did not come to its end")
    assert {"gpio.open", "gpio.drive", "gpio.read", "icap.load", "journal.write"} <= failed


def test_the_manager_holds_its_lines_while_it_runs(made: Rig, sim: SimBoard) -> None:
    with pytest.raises(OSError, match="it is in use"):
        GpioLine.open("zynq_gpio", 54, sim.root)
    made.close()
    GpioLine.open("zynq_gpio", 54, sim.root).close()


def test_a_line_that_the_chip_does_not_have_is_told_by_its_name(sim: SimBoard, config: Config, tmp_path: Path) -> None:
    right = replace(config.regions["right"], decoupler=Decoupler(gpio=Line("zynq_gpio", "no-such-line")))
    with rig(sim.root, tmp_path, replace(config, regions={**config.regions, "right": right})) as started:
        error = started.go("default", config="emio")
    assert error is not None
    assert "no-such-line" in error.message
    assert "gpioinfo lists them" in error.message


def test_a_line_travels_with_the_schema(config: Config) -> None:
    assert config.regions["right"].decoupler == Decoupler(active_high=False, gpio=Line("zynq_gpio", "right-cut"))
    assert loads(dump(config)).regions == config.regions


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ("{}", "base_address is missing"),
        ("{base_address: 0x1000}", "offset is missing"),
        ("{gpio: {chip: zynq_gpio, line: 54}, bit: 3}", "bit is of a register"),
        ("{gpio: {chip: zynq_gpio}}", "line is missing"),
        ("{gpio: {chip: zynq_gpio, line: 1.5}}", "line"),
        ("{gpio: {chip: zynq_gpio, line: right-cut}}", "region left has the same decoupler line"),
    ],
)
def test_a_decoupler_is_either_registers_or_a_line_of_its_own(wrong: str, expected: str) -> None:
    with pytest.raises(SchemaError, match=expected):
        loads(TEXT.replace("{gpio: {chip: zynq_gpio, line: 54}}", wrong))
