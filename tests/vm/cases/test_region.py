# SPDX-License-Identifier: Apache-2.0
"""Bitstreams through the kernel's own frame: overlay, fpga-region, bridge, FPGA manager, port."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from boardfile import FIRMWARE, write_bitstreams
from plsim import nothing, remove_overlays
from served import PATIENCE, driver, loads, pl, until

from cm import device
from cm.formats import fdt
from cm.formats.bitstream import to_dma_words

pytestmark = pytest.mark.needs("overlay", "fpga", "plsim")
NAME = "region-test"
REGION, PORT = "58010000.fpga-bridge", "58012000.fpga-bridge"  # of the region prr0; of the port's own node


def bridge(name: str) -> str:
    """What the bridge of a device says: enabled or disabled."""
    return next(Path("/sys/bus/platform/devices", name, "fpga_bridge").glob("*/state")).read_text().strip()


def firmware(name: str) -> Path:
    """The file that the overlay of a module names."""
    return FIRMWARE / f"{name}.bit.bin"


@pytest.fixture(autouse=True)
def bitstreams() -> None:
    write_bitstreams()
    for name in ("default", "edge"):
        firmware(name).write_bytes(to_dma_words((FIRMWARE / f"{name}.bit").read_bytes()))


@pytest.fixture
def overlays() -> Iterator[device.Overlays]:
    remove_overlays()
    yield device.Overlays("/")
    remove_overlays()


@pytest.fixture
def slow_load() -> Iterator[None]:
    """Loads take half a second, in which they can be met."""
    delay = pl("icap", "delay_us")
    before = delay.read_text()
    delay.write_text("500000")
    yield
    delay.write_text(before)


def dtbo(name: str) -> bytes:
    return (FIRMWARE / f"{name}.dtbo").read_bytes()


def test_an_overlay_loads_its_bitstream_and_its_devices_are_probed(overlays: device.Overlays) -> None:
    before = loads()
    overlays.apply(NAME, dtbo("edge"))
    assert loads() == before + 1
    assert bridge(REGION) == "enabled"
    assert driver("58002000.camera") == "cm_window"
    assert device.FpgaManager(0, "/").state == "operating"
    overlays.remove(NAME)
    assert driver("58002000.camera") is None


def test_the_bridge_of_the_region_is_closed_during_the_load(overlays: device.Overlays, slow_load: None) -> None:
    def look(port: device.Icap) -> tuple[str, str]:
        until(lambda: port.status().state is device.IcapState.LOADING)
        return bridge(REGION), bridge(PORT)

    # Applied by the thread that takes it away: fpga-region has the bridges' mutexes in between, and lockdep
    # reports a thread that ends with them.
    with device.Icap.open() as port, ThreadPoolExecutor(1) as beside:
        during = beside.submit(look, port)
        overlays.apply(NAME, dtbo("default"))
        # the region's is, and that of the port's own node is not
        assert during.result() == ("disabled", "enabled")
    assert bridge(REGION) == "enabled"


def test_a_damaged_bitstream_leaves_the_region_closed_and_a_good_one_opens_it(overlays: device.Overlays) -> None:
    good = firmware("edge").read_bytes()
    damaged = bytearray(good)
    damaged[len(damaged) // 2] ^= 1
    firmware("edge").write_bytes(damaged)
    with pytest.raises(device.DeviceError):
        overlays.apply(NAME, dtbo("edge"))
    assert NAME not in overlays.list()
    assert (bridge(REGION), driver("58002000.camera")) == ("disabled", None)
    firmware("edge").write_bytes(good)
    overlays.apply(NAME, dtbo("edge"))
    assert (bridge(REGION), driver("58002000.camera")) == ("enabled", "cm_window")


def test_a_bitstream_that_is_not_there_is_an_error(overlays: device.Overlays) -> None:
    firmware("edge").unlink()
    before = loads()
    with pytest.raises(device.DeviceError):
        overlays.apply(NAME, dtbo("edge"))
    assert loads() == before
    assert NAME not in overlays.list()


def without_firmware() -> bytes:
    return fdt.pack(fdt.overlay("/pl-bus/fpga-region-0", fdt.FdtNode("", {"test": b""}, [])))


def test_a_region_holds_one_bitstream_at_a_time(overlays: device.Overlays) -> None:
    overlays.apply(NAME, dtbo("edge"))
    before = loads()
    for content in (dtbo("default"), without_firmware(), dtbo("default")):
        with pytest.raises(device.DeviceError):
            overlays.apply(f"{NAME}-second", content)
        # removing what was refused has not closed the bridge of the one that runs, nor let another one in
        assert (bridge(REGION), driver("58002000.camera"), loads()) == ("enabled", "cm_window", before)
    overlays.remove(NAME)
    overlays.apply(f"{NAME}-second", dtbo("default"))


def test_a_region_whose_port_is_gone_loads_nothing(overlays: device.Overlays) -> None:
    folder = Path("/sys/bus/platform/drivers/cm_icap")
    name = next(link.name for link in folder.iterdir() if link.is_symlink() and link.name != "module")
    (folder / "unbind").write_text(name)
    try:
        for _ in range(3):  # the region still has the manager that it found first
            with pytest.raises(device.DeviceError):
                overlays.apply(NAME, dtbo("edge"))
    finally:
        (folder / "bind").write_text(name)
        with nothing():  # another manager for the regions
            pass
    overlays.apply(NAME, dtbo("edge"))
    assert driver("58002000.camera") == "cm_window"


def test_the_bridge_of_the_port_is_closed_during_a_load_and_after_a_failed_one(slow_load: None) -> None:
    words = firmware("edge").read_bytes()
    with device.Icap.open() as port, port.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        port.load(buffer, len(words))
        assert bridge(PORT) == "disabled"
        assert port.wait(PATIENCE).ok
        assert bridge(PORT) == "enabled"
        buffer.array(0, len(words))[len(words) // 2] ^= 1
        port.load(buffer, len(words))
        assert not port.wait(PATIENCE).ok
        assert bridge(PORT) == "disabled"
        buffer.array(0, len(words))[len(words) // 2] ^= 1
        port.load(buffer, len(words))
        assert port.wait(PATIENCE).ok
        assert bridge(PORT) == "enabled"
