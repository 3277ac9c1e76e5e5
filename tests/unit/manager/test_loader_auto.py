# SPDX-License-Identifier: Apache-2.0
"""`loader: auto`: the ICAP if permitted, else the fpga_manager; decided before anything is touched, and reported."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
from manager_support import Rig, rig

from cm.device import DeviceBusy, DeviceNotFound, DevicePermission, FpgaManager, Icap
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


def no_icap(patch: pytest.MonkeyPatch) -> None:
    """Make a board without an ICAP."""

    def missing(*_: object) -> Any:
        raise DeviceNotFound(errno.ENOENT, "no /dev/cm_icap0")

    patch.setattr(Icap, "open", missing)


def no_port(patch: pytest.MonkeyPatch) -> None:
    no_icap(patch)
    patch.setattr(FpgaManager, "can_load", property(lambda _: False))


def denied(patch: pytest.MonkeyPatch) -> None:
    """The firmware does not let the ICAP be selected."""
    said = Icap.info.fget
    assert said is not None
    patch.setattr(Icap, "info", property(lambda port: replace(said(port), denied=True)))


def loaders(made: Rig) -> set[str]:
    return {region.loader for region in made.manager.status().regions}


def test_a_board_without_an_icap_loads_by_the_fpga_manager_and_says_why(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    no_icap(monkeypatch)
    made.arm(-1)
    assert made.go("both", config="duo") is None
    assert made.fault.names.count("fpga_manager.load") == 2
    assert loaders(made) == {"fpga_manager (icap: no /dev/cm_icap0)"}


@pytest.mark.parametrize(
    ("lacks", "left_open", "code", "text"),
    [
        (no_port, True, "no_port", "icap: no /dev/cm_icap0; fpga_manager: this kernel's fpga_manager has no firmware"),
        (denied, False, "load_failed", "pm_mmio_access.c"),
    ],
    ids=["no port", "the port that the schema insists on"],
)
def test_a_region_that_cannot_be_loaded_is_refused_before_it_is_cut_off(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    lacks: Callable[[pytest.MonkeyPatch], None], left_open: bool, code: str, text: str
) -> None:  # fmt: skip
    lacks(monkeypatch)
    with rig(sim.root, tmp_path / "state", automatic(configs["duo"]) if left_open else configs["duo"]) as made:
        made.arm(-1)
        error = made.go("both", config="duo")
        assert (error.code, text in error.message) == (code, True)
        assert "uio.write" not in made.fault.names


def test_a_restarted_manager_trusts_what_was_loaded_by_a_port_that_it_chose(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    assert made.go("both", config="duo") is None
    made.close()
    with rig(sim.root, tmp_path / "state", automatic(configs["duo"])) as again:
        assert {r.phase.value for r in again.manager.state.regions.values()} == {"ready"}


@pytest.mark.parametrize("left_open", [True, False])
@pytest.mark.parametrize(
    "refusal",
    [DeviceBusy(16, "the port is busy"), DevicePermission(13, "the firmware does not give it")],
    ids=lambda error: error.code,
)
def test_the_fpga_manager_loads_what_the_icap_refuses_if_it_may_and_the_next_change_asks_the_icap_again(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, refusal: DeviceBusy, left_open: bool
) -> None:
    with rig(sim.root, tmp_path / "state", automatic(configs["duo"]) if left_open else configs["duo"]) as made:
        assert made.go("default", config="duo") is None
        refusals: list[Exception] = [refusal]

        def refuse(name: str) -> None:
            if name == "icap.load" and refusals:
                raise refusals.pop()

        made.fault.watch = refuse
        error = made.go("other", config="duo")
        status = made.manager.status()
        if not left_open:
            assert (error.code, status.mode) == (refusal.code, "default")
            return
        assert (error, status.mode, status.pr_mode.value) == (None, "other", "idle")
        assert status.regions[0].loader == f"fpga_manager (icap: {refusal})"
        assert made.go("default", config="duo") is None
        assert loaders(made) == {"icap"}
