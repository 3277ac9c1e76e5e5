# SPDX-License-Identifier: Apache-2.0
"""Who takes a window's pages back without being asked: its bridge, its driver's end, the system's sleep."""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Iterator
from pathlib import Path

import plsim
import pytest
from boardfile import FIRMWARE, write_bitstreams
from served import PATIENCE, until
from test_suspend import suspend

from cm import device
from cm.device import WindowEnd
from cm.formats import fdt
from cm.formats.bitstream import to_dma_words

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
PAGE = os.sysconf("SC_PAGE_SIZE")
LENT = 0x58008000  # of the tree, whose bridge is in front of prr1's decoupler
DECOUPLER = 0x58011000
REGION = "/pl-bus/fpga-region-1"
SIMULATED = 0x43C00000
DRIVER = Path("/sys/bus/platform/drivers/cm_window")


@pytest.fixture
def windows() -> Iterator[device.Windows]:
    with device.Windows.open("/") as opened:
        yield opened


def lend(windows: device.Windows, address: int) -> device.MappedWindow:
    with windows.grant(address, PAGE, write=True) as grant:
        return device.MappedWindow(grant.fd)


def told(windows: device.Windows) -> list[WindowEnd]:
    assert select.select([windows], [], [], PATIENCE)[0]
    return [event.reason for event in windows.take()]


def loading() -> bytes:
    """An overlay that has the kernel load the region behind the window."""
    write_bitstreams()
    words = to_dma_words((FIRMWARE / "loopback.bit").read_bytes())
    Path("/lib/firmware/window-test.bin").write_bytes(words)
    content = {"firmware-name": b"window-test.bin\0", "partial-fpga-config": b""}
    return fdt.pack(fdt.overlay(REGION, fdt.FdtNode("", content, [])))


def anew() -> None:
    """The window as after boot: its bridge is open."""
    for step in ("unbind", "bind"):
        (DRIVER / step).write_text(f"{LENT:x}.lent")


def lent() -> int:
    return int(Path("/sys/kernel/debug/cm_window/lent").read_text())


def test_a_window_whose_device_goes_is_taken_back(windows: device.Windows) -> None:
    attributes: dict[str, plsim.Attributes] = {"test": {"address": hex(SIMULATED), "size": 2 * PAGE}}
    with plsim.nothing():
        with plsim.board({}, attributes):
            window = lend(windows, SIMULATED)
            window.write(0, 5)
            assert window.read(0) == 5
        assert window.revoked is WindowEnd.GONE
        assert told(windows) == [WindowEnd.GONE]
        with pytest.raises(device.DeviceGone):
            windows.grant(SIMULATED, PAGE)
        before = lent()
        window.close()
        assert told(windows) == [WindowEnd.RELEASED]
        assert lent() == before - 1


@pytest.mark.needs("overlay")
def test_a_window_whose_driver_is_unbound_is_taken_back_and_lent_again_when_it_is_back(
    windows: device.Windows,
) -> None:
    name = f"{LENT:x}.lent"
    assert (DRIVER / name).exists()
    with lend(windows, LENT) as window:
        window.write(8, 3)
        (DRIVER / "unbind").write_text(name)
        try:
            assert window.revoked is WindowEnd.GONE
        finally:
            (DRIVER / "bind").write_text(name)
    with lend(windows, LENT) as window:
        assert window.read(8) == 3


@pytest.mark.needs("overlay", "fpga")
def test_a_load_by_the_kernel_takes_the_pages_back_before_it_decouples(windows: device.Windows) -> None:
    overlays = device.Overlays("/")
    with lend(windows, LENT) as before:
        before.write(8, 4)
        overlays.apply("window-test", loading())
        try:
            with pytest.raises(device.DeviceRevoked) as error:
                before.read(8)
            assert error.value.reason is WindowEnd.BRIDGE
            assert told(windows) == [WindowEnd.BRIDGE]
            with lend(windows, LENT) as after:  # the load has ended, and the bridge is open
                assert after.read(8) == 4
                overlays.remove("window-test")
                assert after.revoked is WindowEnd.BRIDGE
            with pytest.raises(device.DeviceError) as refused:  # the kernel leaves a region without overlay cut off
                windows.grant(LENT, PAGE)
            assert refused.value.errno == errno.EAGAIN
        finally:
            if "window-test" in overlays.list():
                overlays.remove("window-test")
            anew()


@pytest.mark.needs("suspend")
def test_a_window_is_taken_back_when_the_system_goes_to_sleep_and_lent_when_it_is_awake(
    windows: device.Windows,
) -> None:
    attributes: dict[str, plsim.Attributes] = {"test": {"address": hex(SIMULATED), "size": 2 * PAGE}}
    with plsim.nothing(), plsim.board({}, attributes):
        with lend(windows, SIMULATED) as window:
            suspend()
            assert window.revoked is WindowEnd.SLEEP
        assert told(windows)[0] is WindowEnd.SLEEP
        lend(windows, SIMULATED).close()


@pytest.mark.needs("overlay", "fpga")
def test_a_region_outlives_the_window_that_is_its_bridge() -> None:
    overlays, name = device.Overlays("/"), f"{LENT:x}.lent"
    overlays.apply("window-test", loading())
    (DRIVER / "unbind").write_text(name)
    overlays.remove("window-test")  # the region calls a bridge whose device is gone
    (DRIVER / "bind").write_text(name)
    overlays.apply("window-test", loading())
    overlays.remove("window-test")
    anew()


@pytest.mark.needs("overlay", "fpga")
def test_bridges_of_windows_that_were_unbound_are_given_back() -> None:
    bridges = Path("/sys/kernel/debug/cm_window/bridges")
    before = int(bridges.read_text())
    for _ in range(20):
        anew()
    until(lambda: int(bridges.read_text()) <= before)  # those that were unbound before may have gone too
    overlays = device.Overlays("/")
    overlays.apply("window-test", loading())  # and the one that is there still serves
    overlays.remove("window-test")
    anew()


@pytest.mark.needs("overlay")
def test_a_page_that_a_decoupler_is_in_is_not_lent(windows: device.Windows) -> None:
    with pytest.raises(device.DeviceGone):
        windows.grant(DECOUPLER, PAGE)
