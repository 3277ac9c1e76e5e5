# SPDX-License-Identifier: Apache-2.0
"""A partial configuration belongs to a static design: the board's identity is compared before a load."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_support import Rig, rig

from cm.schema import load
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode

TEXT = """
config:
  name: {name}
  type: {type}
  device: xc7z020
  {static}
  regions:
    prr0: {{decoupler: {{base_address: 0x1000, offset: 0x0}}}}
  modules:
    {name}_a: {{region: prr0}}
    {name}_b: {{region: prr0}}
  modes:
    default: {{modules: [{name}_a]}}
    other: {{modules: [{name}_b]}}
"""
STATIC = "static: {{identity: {}, base_address: 0x1000, offset: 0x40}}"
CONFIGS = {
    "ours": ("partial", STATIC.format("0xa5a50001")),
    "theirs": ("partial", STATIC.format("0xa5a50002")),
    "silent": ("partial", "doc: says nothing"),
    "nowhere": ("partial", "static: {identity: 1, base_address: 0x9000000}"),
    "image": ("full", STATIC.format("0xa5a50002")),
}


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    folder = tmp_path_factory.mktemp("statics")
    for name, (kind, static) in CONFIGS.items():
        (folder / f"{name}.yaml").write_text(TEXT.format(name=name, type=kind, static=static), encoding="utf-8")
    return {name: load(folder / f"{name}.yaml") for name in CONFIGS}


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config]) -> Iterator[SimBoard]:
    """A board with the static design of `ours`, and nothing at the address where `nowhere` expects its identity."""
    given = [path for config in configs.values() if (path := config.source) is not None and config.name != "nowhere"]
    with SimBoard(
        [p for p in given if p.stem == "ours"] + [p for p in given if p.stem != "ours"],
        arguments=["--icap-rate", "0", "--pcap-rate", "0"],
    ) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started


def steps(made: Rig, config: str) -> list[str]:
    return [step.text for step in made.manager.plan(ChangeMode(config_name=config, mode="default")).steps]


def test_modules_are_loaded_into_the_static_part_that_they_were_made_with(made: Rig, sim: SimBoard) -> None:
    assert "check that the static part is 0xa5a50001" in steps(made, "ours")
    assert made.go("default", config="ours") is None
    assert sim.control.state()["regions"]["prr0"]["module"] == "ours_a"


def test_modules_of_another_static_part_are_refused_before_anything_is_touched(made: Rig, sim: SimBoard) -> None:
    assert made.go("default", config="ours") is None
    before = sim.control.state()
    made.arm(-1)
    error = made.go("default", config="theirs")
    assert error.code == "wrong_static"
    assert error.message.startswith(
        "check that the static part is 0xa5a50002: theirs was made with another static design than the device holds: "
        "expected 0xa5a50002, the board has 0xa5a50001; load the image that belongs to it; "
    )
    assert "uio.write" not in made.fault.names
    after = sim.control.state()
    assert (after["regions"], after["loads"]) == (before["regions"], before["loads"])
    status = made.manager.status()
    assert (status.config_name, status.mode) == ("ours", "default")


def test_unknown_facts_are_stated_once_in_the_plan(made: Rig) -> None:
    unknown = "assume the static part of silent (its identity is not known)"
    assert steps(made, "silent").count(unknown) == 1
    assert made.go("default", config="silent") is None
    assert steps(made, "silent") == []


def test_modules_within_the_image_that_the_manager_loaded_are_checked_behind_its_load(made: Rig) -> None:
    """The simulated board's register keeps its value, so the image turns out to be another one."""
    texts = steps(made, "image")
    assert texts.index("check that the static part is 0xa5a50002") > next(
        number for number, text in enumerate(texts) if text.startswith("load the whole device")
    )
    assert made.go("default", config="image").code in ("wrong_static", "undo_failed")


def test_nothing_is_loaded_on_a_board_that_does_not_answer(
    sim: SimBoard, configs: dict[str, Config], made: Rig
) -> None:
    source, target = sim.root / "lib/firmware/cm/ours", sim.root / "lib/firmware/cm/nowhere"
    target.mkdir(exist_ok=True)
    (target / "nowhere_a.bit").write_bytes((source / "ours_a.bit").read_bytes())
    loads = sim.control.state()["loads"]
    error = made.go("default", config="nowhere")
    assert error.code == "device_not_found"
    assert sim.control.state()["loads"] == loads
