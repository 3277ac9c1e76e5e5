# SPDX-License-Identifier: Apache-2.0
"""Packages of others: unless the plan knows what an overlay would make the kernel load, nothing is touched.

They resemble those of PYNQ and dfx-mgr: an image, and an overlay of the same name that names an image below
/lib/firmware, where other projects put theirs too.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_support import Rig, killed_at, place_of, rig

from cm.formats import fdt
from cm.formats.bitstream import Container, FrameAddress, FrameRun, assemble, convert, device_by_name
from cm.schema import load
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard

NETWORK = """
config:
  name: network
  type: full
  device: xc7z020
  bitstream: network.bit
  regions:
    slot: {decoupler: {base_address: 0x1000, offset: 0x0}, loader: fpga_manager}
  modules:
    filter: {region: slot}
  overlays: [network]
  clocks: {fclk0: 100_000_000}
  modes:
    default: {}
    filtered: {modules: [filter]}
"""

SLOTS = """
config:
  name: slots
  type: partial
  device: xc7z020
  regions:
    slot: {decoupler: {base_address: 0x1000, offset: 0x0}, loader: fpga_manager}
  modules:
    fir: {region: slot}
  modes:
    default: {modules: [fir], overlays: [fir_devices]}
    bare: {modules: [fir]}
"""


def whole(design: str) -> bytes:
    """An image of the whole device, as Vivado writes it."""
    device = device_by_name("xc7z020")
    assert device is not None
    content = design.encode().ljust(4 * device.family.frame_words, b"\0")
    return assemble(device, [FrameRun(FrameAddress(0, 9, 0), content * 8)], design=design, partial=False)


def overlay_naming(firmware: str, **flags: bytes) -> bytes:
    """A package's overlay: it loads an image and adds a device."""
    device = fdt.FdtNode("ip@43c00000", {"compatible": b"xlnx,ip\0"})
    named = {"firmware-name": firmware.encode() + b"\0"}
    named |= {key.replace("_", "-"): value for key, value in flags.items()}
    return fdt.pack(fdt.overlay("/fpga-full", fdt.FdtNode("", named, [device])))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packages, initially correct."""
    made = tmp_path_factory.mktemp("packages")
    (made / "network.bit").write_bytes(whole("network"))
    (made / "network.dtbo").write_bytes(overlay_naming("network.bin"))
    (made / "network.yaml").write_text(NETWORK, encoding="utf-8")
    (made / "slots.yaml").write_text(SLOTS, encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def configs(folder: Path) -> dict[str, Config]:
    return {name: load(folder / f"{name}.yaml") for name in ("network", "slots")}


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config], folder: Path) -> Iterator[SimBoard]:
    with SimBoard([folder], arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        yield board


@pytest.fixture
def firmware(sim: SimBoard) -> Iterator[Path]:
    """/lib/firmware of the board; what a test puts there and beside the packages goes with it."""
    place = sim.root / "lib/firmware"
    before = {path: path.read_bytes() for path in place.iterdir() if path.is_file()}
    yield place
    for path in [path for path in place.iterdir() if path.is_file() and path not in before]:
        path.unlink()


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started


def refused(made: Rig, sim: SimBoard, config: str, mode: str = "default") -> str:
    """The reason why a change is refused as a bad overlay, with nothing loaded and nothing applied."""
    before = sim.control.state()
    error = made.go(mode, config=config)
    after = sim.control.state()
    assert error is not None
    assert error.code == "bad_overlay"
    assert {key: after[key] for key in ("loads", "regions", "overlays")} == {
        key: before[key] for key in ("loads", "regions", "overlays")
    }
    assert made.manager.status().pr_mode.value == "idle"
    return str(error.message)


def test_a_package_is_loaded_once_and_its_overlay_stays_as_it_is(
    made: Rig, sim: SimBoard, folder: Path, firmware: Path
) -> None:
    (firmware / "network.bin").write_bytes(convert(whole("network"), Container.BIN_SWAPPED) + b"\0\0\0\x20")
    written, loads = (folder / "network.dtbo").read_bytes(), sim.control.state()["loads"]
    assert made.go("filtered", config="network") is None
    state = sim.control.state()
    assert state["loads"] == loads + 2
    assert state["overlays"] == ["network"]
    assert state["regions"]["slot"] == {"module": "filter", "loading": False, "decoupled": False}
    assert (folder / "network.dtbo").read_bytes() == written


def test_the_image_of_another_project_under_the_same_name_is_refused(made: Rig, sim: SimBoard, firmware: Path) -> None:
    (firmware / "network.bin").write_bytes(convert(whole("somebody's"), Container.BIN_SWAPPED))
    reason = refused(made, sim, "network")
    assert f"another bitstream, {firmware / 'network.bin'}" in reason
    assert "network.bit" in reason


@pytest.mark.parametrize("kept", [0, 40, 400, 3000])
def test_a_truncated_image_is_refused(made: Rig, sim: SimBoard, firmware: Path, kept: int) -> None:
    (firmware / "network.bin").write_bytes(convert(whole("network"), Container.BIN_SWAPPED)[:kept])
    refused(made, sim, "network")


def test_a_whole_image_under_a_partial_configuration_is_refused_and_the_modules_stay(
    made: Rig, sim: SimBoard, folder: Path, firmware: Path
) -> None:
    (firmware / "network.bin").write_bytes(convert(whole("network"), Container.BIN_SWAPPED))
    (folder / "fir_devices.dtbo").write_bytes(overlay_naming("network.bin"))
    assert made.go("bare", config="slots") is None
    assert "the plan knows" in refused(made, sim, "slots")
    assert made.manager.state.region("slot").module == "fir"
    assert sim.control.state()["regions"]["slot"]["module"] == "fir"


def test_the_module_that_an_overlay_names_is_loaded_once(
    made: Rig, sim: SimBoard, folder: Path, firmware: Path
) -> None:
    image = (firmware / "cm/slots/fir.bit").read_bytes()
    (folder / "fir_devices.dtbo").write_bytes(overlay_naming("fir_image.bit.bin", partial_fpga_config=b""))
    (folder / "fir_image.bin").write_bytes(convert(image, Container.BIN_SWAPPED))  # named otherwise, as often
    loads = sim.control.state()["loads"]
    error = made.go("default", config="slots")
    assert error is None
    assert sim.control.state()["loads"] - loads <= 1
    assert sim.control.state()["overlays"] == ["fir_devices"]


# ---- whatever fails, and wherever the manager dies ------------------------------------------


START, GOAL = ("slots", "bare"), ("network", "filtered")  # a package with its own image, an overlay and a clock


def begin(made: Rig) -> None:
    """Start in the slots of the package's image, with an arbitrary rate of the clock."""
    made.arm(-1)
    assert made.go("default", config="network") is None
    assert made.go(START[1], config=START[0]) is None
    made.devices.clocks().find("fclk0").rate = 25_000_000


def told(made: Rig, sim: SimBoard, configs: dict[str, Config]) -> tuple[str, str]:
    """Where the manager says that the board is, checked against the board and its clocks."""
    place_of(made, sim, configs)
    status, held = made.manager.status(), sim.control.state()
    for clock in status.clocks:
        assert held["clocks"][clock.name] == clock.rate
    if status.config_name == START[0]:
        assert held["clocks"]["fclk0"] == 24_999_999  # not requested by anybody, but what was set before
    return status.config_name, status.mode


@pytest.fixture
def package(firmware: Path) -> None:
    (firmware / "network.bin").write_bytes(convert(whole("network"), Container.BIN_SWAPPED))


@pytest.mark.usefixtures("package")
def test_one_failure_of_any_operation_ends_in_the_old_mode_or_the_new(
    made: Rig, sim: SimBoard, configs: dict[str, Config]
) -> None:
    failed, end = 0, ("", "")
    for number in range(200):
        if end != START:
            begin(made)
        made.arm(number)
        error = made.go(GOAL[1], config=GOAL[0])
        reached = len(made.fault.names) > number
        made.arm(-1)
        end = told(made, sim, configs)
        assert end == (START if error else GOAL), f"operation {number}: {error}"
        failed += error is not None
        if not reached:
            break
    assert failed > 20


@pytest.mark.usefixtures("package")
def test_a_manager_killed_at_any_operation_comes_back_knowing(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    ends, number = set(), 0
    with rig(sim.root, tmp_path, *configs.values()) as first:
        begin(first)
    while killed_at(sim.root, tmp_path, configs.values(), GOAL, number):
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            lost = again.manager.state.static_lost
            end = told(again, sim, configs)
            assert lost or end in (START, GOAL), f"killed at operation {number}: {again.notes}"
            assert not lost or any("full image" in note for note in again.notes)
            ends.add(end)
            if end != START:
                begin(again)
        number += 3
    assert START in ends
    assert number > 20
