# SPDX-License-Identifier: Apache-2.0
"""`loader: auto`: the ICAP if permitted, else the fpga_manager; decided before anything is touched, and reported."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from manager_support import Rig, rig

from cm.device import DeviceNotFound, FpgaManager, Icap
from cm.schema import loads
from cm.schema.model import Config, LoaderKind
from cm.simulation.software import Board as SimBoard


def automatic(config: Config) -> Config:
    """The same configuration, with its regions' loaders left open."""
    regions = {n: replace(r, loader=LoaderKind.AUTO, loader_name=None) for n, r in config.regions.items()}
    return replace(config, regions=MappingProxyType(regions))


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path / "state", automatic(configs["duo"])) as started:
        yield started
        sim.control.clear()


@pytest.fixture
def no_icap(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a board without an ICAP."""

    def missing(_: str | None) -> Any:
        raise DeviceNotFound(errno.ENOENT, "no /dev/cm_icap0")

    monkeypatch.setattr(made.devices, "icap", missing)


@pytest.fixture
def denied(monkeypatch: pytest.MonkeyPatch) -> None:
    """The firmware does not let the ICAP be selected."""
    said = Icap.info.fget
    assert said is not None
    monkeypatch.setattr(Icap, "info", property(lambda port: replace(said(port), denied=True)))


def loaders(made: Rig) -> set[str]:
    return {region.loader for region in made.manager.status().regions}


@pytest.mark.usefixtures("no_icap")
def test_a_board_without_an_icap_loads_by_the_fpga_manager_and_says_why(made: Rig) -> None:
    made.arm(-1)
    assert made.go("both", config="duo") is None
    assert made.fault.names.count("fpga_manager.load") == 2
    (told,) = loaders(made)
    assert told.startswith("fpga_manager (icap: ")
    assert "no /dev/cm_icap0" in told


def test_a_region_that_nothing_can_load_is_refused_before_it_is_cut_off(
    made: Rig, no_icap: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FpgaManager, "can_load", property(lambda _: False))
    made.arm(-1)
    error = made.go("both", config="duo")
    assert error is not None
    assert error.code == "no_port"
    assert "no /dev/cm_icap0" in error.message
    assert "no firmware attribute" in error.message
    assert not [name for name in made.fault.names if name.startswith("window.write")]


@pytest.mark.usefixtures("denied")
def test_a_refused_icap_that_the_schema_insists_on_leaves_the_decouplers_as_they_were(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    with rig(sim.root, tmp_path / "state", configs["duo"]) as made:
        made.arm(-1)
        error = made.go("both", config="duo")
        assert error is not None
        assert "SECURE_ACCESS" in error.message
        assert not [name for name in made.fault.names if name.startswith("window.write")]


def test_a_restarted_manager_trusts_what_was_loaded_by_a_port_that_it_chose(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    assert made.go("both", config="duo") is None
    made.close()
    with rig(sim.root, tmp_path / "state", automatic(configs["duo"])) as again:
        assert {r.phase.value for r in again.manager.state.regions.values()} == {"ready"}


def test_the_schema_takes_it_for_regions_and_not_for_the_whole_device() -> None:
    text = "config:\n  name: x\n  regions:\n    r: {loader: auto}\n  modules: {m: {}}\n  modes: {d: {modules: [m]}}\n"
    assert loads(text).regions["r"].loader is LoaderKind.AUTO
    with pytest.raises(Exception, match="loader"):
        loads(text.replace("  regions:", "  type: full\n  loader: auto\n  regions:"))
