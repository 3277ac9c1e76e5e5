# SPDX-License-Identifier: Apache-2.0
"""Who takes a window's pages back without being asked: its bridge, its driver's end, the system's sleep."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator
from pathlib import Path

import plsim
import pytest
from served import PATIENCE
from test_suspend import suspend

from cm import device
from cm.device import WindowEnd

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
PAGE = os.sysconf("SC_PAGE_SIZE")
LENT = 0x58008000  # of the tree, whose bridge is in front of prr1's decoupler
DECOUPLER = 0x58011000
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
    from test_region import dtbo, firmware, write_bitstreams

    from cm.formats.bitstream import to_dma_words

    write_bitstreams()
    source = firmware("loopback").with_name("loopback.bit")
    firmware("loopback").write_bytes(to_dma_words(source.read_bytes()))
    overlays = device.Overlays("/")
    with lend(windows, LENT) as window:
        window.write(8, 4)
        overlays.apply("window-test", dtbo("loopback"))
        try:
            with pytest.raises(device.DeviceRevoked) as error:
                window.read(8)
            assert error.value.reason is WindowEnd.BRIDGE
            assert told(windows) == [WindowEnd.BRIDGE]
        finally:
            overlays.remove("window-test")
    with lend(windows, LENT) as window:  # the bridge is open again
        assert window.read(8) == 4


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


@pytest.mark.needs("overlay")
def test_a_page_that_a_decoupler_is_in_is_not_lent(windows: device.Windows) -> None:
    with pytest.raises(device.DeviceGone):
        windows.grant(DECOUPLER, PAGE)
