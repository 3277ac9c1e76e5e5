# SPDX-License-Identifier: Apache-2.0
"""Devices of the static part that come with the configuration's own overlay, such as the port."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_support import Rig, make_rig

from cm.device import DeviceClosed, DeviceNotFound
from cm.formats import fdt
from cm.schema import load
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode

TEXT = """
config:
  name: {name}
  type: partial
  device: xc7z020
  overlays: [{name}_static]
  regions:
    prr0: {{loader: auto, decoupler: {{base_address: 0x1000, offset: 0x0}}}}
  modules:
    a: {{region: prr0}}
    b: {{region: prr0}}
  modes:
    default: {{modules: [a], overlays: [{name}_a]}}
    other: {{modules: [b]}}
"""
OVERLAYS = ("one_static", "one_a", "two_static", "two_a")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two configurations, each with its own static overlay."""
    made = tmp_path_factory.mktemp("ground")
    for name in ("one", "two"):
        (made / f"{name}.yaml").write_text(TEXT.format(name=name), encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def sim(folder: Path) -> Iterator[SimBoard]:
    given = [folder / "one.yaml", folder / "two.yaml"]
    with SimBoard(given, arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        for name in OVERLAYS:
            place = board.root / "lib/firmware/cm" / name.split("_")[0]
            node = fdt.FdtNode("", {}, [fdt.FdtNode(name.replace("_", "-"), {})])
            (place / f"{name}.dtbo").write_bytes(fdt.pack(fdt.overlay("/", node)))
        yield board


class WithStatic:
    """The port is there while a static part's overlay is."""

    def __init__(self, rig: Rig) -> None:
        self._icap, self._rig = rig.devices.icap, rig

    def icap(self, name: str | None) -> Any:
        if not any(overlay.endswith("_static") for overlay in self._rig.devices.overlays().list()):
            raise DeviceNotFound("no port before the overlay that brings it")
        return self._icap(name)


@pytest.fixture
def made(sim: SimBoard, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    configs: list[Config] = [load(folder / f"{name}.yaml") for name in ("one", "two")]
    rig = make_rig(sim.root, tmp_path, *configs)
    monkeypatch.setattr(rig.devices, "icap", WithStatic(rig).icap)
    rig.manager.start()
    yield rig
    rig.close()
    for name in reversed(applied(sim)):
        with contextlib.suppress(Exception):
            rig.devices.overlays().remove(name)
    sim.control.clear()


def applied(sim: SimBoard) -> list[str]:
    return list(sim.control.state()["overlays"])


def kinds(rig: Rig, config: str = "one", mode: str = "default") -> list[str]:
    return [step.kind for step in rig.manager.plan(ChangeMode(config_name=config, mode=mode)).steps]


def test_the_port_may_come_with_the_configurations_own_overlay_and_the_plan_shows_it(made: Rig, sim: SimBoard) -> None:
    steps = kinds(made)
    assert steps[:2] == ["validate", "overlay_apply"]
    assert steps.index("overlay_apply") < steps.index("decouple") < steps.index("load") < steps.index("publish")
    assert steps.count("overlay_apply") == 2
    assert made.go("default", config="one") is None
    assert applied(sim) == ["one_static", "one_a"]
    assert made.manager.status().mode == "default"


def test_the_overlay_stays_while_the_configuration_does(made: Rig, sim: SimBoard) -> None:
    made.go("default", config="one")
    made.arm(-1)
    assert made.go("other", config="one") is None
    assert made.fault.names.count("overlays.remove") == 1  # the mode's
    assert applied(sim) == ["one_static"]


def test_another_configurations_overlays_go_first(made: Rig, sim: SimBoard) -> None:
    made.go("default", config="one")
    assert made.go("default", config="two") is None
    assert applied(sim) == ["two_static", "two_a"]


@pytest.mark.parametrize("force", [False, True])
def test_a_load_that_fails_goes_back_to_the_configuration_before(made: Rig, sim: SimBoard, force: bool) -> None:
    made.go("default", config="one")
    made.arm(-1)
    made.go("other", config="two")
    at = made.fault.names.index("icap.load")
    made.go("default", config="one")
    made.arm(at)
    change = made.manager.submit(ChangeMode(config_name="two", mode="other", force=force))
    assert change.wait(60.0)
    assert change.error is not None
    assert (made.manager.status().config_name, applied(sim)) == ("one", ["one_static", "one_a"])


def test_if_the_port_does_not_appear_the_change_fails_and_says_so(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(name: str | None) -> Any:
        raise DeviceNotFound("no port at all")

    monkeypatch.setattr(made.devices, "icap", gone)
    monkeypatch.setattr(made.devices, "fpga_manager", gone)
    error = made.go("default", config="one")
    assert error is not None
    assert error.code == "no_port"


def test_register_devices_that_an_overlay_leaves_alone_stay_open(made: Rig) -> None:
    made.go("default", config="one")
    before = made.devices.uio("uio0")
    assert made.go("other", config="one") is None  # takes the mode's overlay off
    assert made.devices.uio("uio0") is before


def test_a_device_that_has_come_in_place_of_another_is_opened_anew(made: Rig, sim: SimBoard) -> None:
    made.go("default", config="one")
    before, folder = made.devices.uio("uio0"), sim.root / "sys/class/uio/uio0"
    shutil.copytree(folder, folder.with_name("newer"))
    shutil.rmtree(folder)
    folder.with_name("newer").rename(folder)
    assert made.go("other", config="one") is None
    assert made.devices.uio("uio0") is not before
    with pytest.raises(DeviceClosed):
        before.read(0)


def test_a_port_that_has_come_in_place_of_another_is_opened_anew_and_filled_anew(made: Rig, sim: SimBoard) -> None:
    for mode in ("default", "other"):  # from here on both images wait in the port's memory
        assert made.go(mode, config="one") is None
    before, node = made.devices.icap(None), sim.root / "dev/cm_icap0"
    node.rename(node.with_name("moved"))
    node.with_name("moved").rename(node)
    assert made.go("default", config="one") is None  # puts the mode's overlay on, and its next load finds the new port
    made.arm(-1)
    assert made.go("other", config="one") is None
    assert made.devices.icap(None) is not before
    with pytest.raises(DeviceClosed):
        before.status()
    assert "icap.load" in made.fault.names
    assert sim.control.state()["regions"]["prr0"]["module"] == "b"
