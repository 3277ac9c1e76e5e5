# SPDX-License-Identifier: Apache-2.0
"""A port that refuses a load: another port is used if the schema leaves the choice open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_support import Rig, make_rig

from cm.device import DeviceBusy, DevicePermission
from cm.schema import load
from cm.simulation.software import Board as SimBoard

TEXT = """
config:
  name: {name}
  type: partial
  device: xc7z020
  regions:
    prr0: {{loader: {loader}, decoupler: {{base_address: 0x1000, offset: 0x0}}}}
  modules:
    a: {{region: prr0}}
    b: {{region: prr0}}
  modes:
    default: {{modules: [a]}}
    other: {{modules: [b]}}
"""


class Refusing:
    """An ICAP that refuses as many loads as it is armed for."""

    def __init__(self, inner: Any) -> None:
        self.inner, self.refusals = inner, []  # type: Any, list[Exception]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def load(self, *args: Any, **words: Any) -> Any:
        if self.refusals:
            raise self.refusals.pop(0)
        return self.inner.load(*args, **words)


@pytest.fixture(scope="module")
def sim(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimBoard]:
    folder = tmp_path_factory.mktemp("refused")
    for name, loader in (("open", "auto"), ("fixed", "icap")):
        (folder / f"{name}.yaml").write_text(TEXT.format(name=name, loader=loader), encoding="utf-8")
    with SimBoard(sorted(folder.glob("*.yaml")), arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        board.schemas = folder  # type: ignore[attr-defined]
        yield board


@pytest.fixture
def port() -> Refusing:
    return Refusing(None)


@pytest.fixture
def made(sim: SimBoard, port: Refusing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    folder: Path = sim.schemas  # type: ignore[attr-defined]
    rig = make_rig(sim.root, tmp_path, *(load(path) for path in sorted(folder.glob("*.yaml"))))
    real = rig.devices.icap

    def icap(name: str | None) -> Refusing:
        port.inner = real(name)
        return port

    monkeypatch.setattr(rig.devices, "icap", icap)
    rig.manager.start()
    yield rig
    rig.close()
    sim.control.clear()


REFUSALS = [DeviceBusy(16, "the port is busy"), DevicePermission(13, "the firmware does not give it")]


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda error: error.code)
def test_the_fpga_manager_loads_what_the_icap_refuses_and_the_status_says_so(
    made: Rig, port: Refusing, refusal: Exception
) -> None:
    made.go("default", config="open")
    port.refusals = [refusal]
    assert made.go("other", config="open") is None
    status = made.manager.status()
    assert (status.mode, status.last_error) == ("other", None)
    told = status.regions[0].loader
    assert told.startswith("fpga_manager")
    assert str(refusal) in told


def test_the_next_change_asks_the_icap_again(made: Rig, port: Refusing) -> None:
    port.refusals = [DeviceBusy(16, "the port is busy")]
    assert made.go("default", config="open") is None
    assert made.go("other", config="open") is None
    assert made.manager.status().regions[0].loader == "icap"


def test_a_port_that_the_schema_names_is_the_only_one(made: Rig, port: Refusing) -> None:
    made.go("default", config="fixed")
    port.refusals = [DeviceBusy(16, "the port is busy")]
    error = made.go("other", config="fixed")
    assert error is not None
    assert error.code == "device_busy"
    assert made.manager.status().mode == "default"
