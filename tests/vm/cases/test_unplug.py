# SPDX-License-Identifier: Apache-2.0
"""What goes away while it is used, and all of it going away and coming back."""

from __future__ import annotations

import contextlib
import subprocess
from pathlib import Path

import plsim
import pytest
from capabilities import LOOK
from served import PATIENCE, until

from cm import device

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
MODULES = ("cm_axidma_compat", "cm_plsim", "cm_icap", "cm_dma")  # in the order in which they can go


def modules(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (command, done.stderr)


def loop() -> None:
    """One trip through the loop of the board that is there now."""
    with (
        device.AxiDma.open("to_pl") as out,
        device.AxiDma.open("from_pl") as back,
        out.allocate(64) as source,
        back.allocate(64) as target,
    ):
        back.submit(target, length=64)
        out.submit(source, length=64)
        assert (out.wait(PATIENCE).status, back.wait(PATIENCE).length) == (0, 64)


def test_the_board_goes_away_under_open_files_and_comes_back() -> None:
    if LOOK["overlay"]():
        pytest.skip("the kernel leaks nodes of an overlay that goes under open files; unbinding is tested instead")
    with (
        device.AxiDma.open("from_pl") as channel,
        channel.allocate(4096) as target,
        device.Icap.open() as port,
        device.Uio.open(0x58001000) as uio,
    ):
        channel.submit(target, length=4096)
        with plsim.nothing():
            with pytest.raises(device.DeviceError):
                channel.submit(target, length=4096)
            with pytest.raises(device.DeviceError):
                port.allocate(4096)
        assert uio.name
    loop()


def test_twenty_times_there_and_gone() -> None:
    for _ in range(20):
        with plsim.nothing():
            pass
        assert "camera" in device.list_dma()
    loop()


def test_all_modules_go_and_come_back() -> None:
    with plsim.nothing():
        folder = plsim.LIVE.parent
        if folder.exists():
            pytest.skip("the board's description in configfs holds cm_plsim")
        modules("modprobe", MODULES[0])
        for name in MODULES:
            modules("rmmod", name)
            assert not Path("/sys/module", name).exists()
        modules("modprobe", "-a", *reversed(MODULES[1:]))
    loop()


@pytest.mark.needs("overlay")
@pytest.mark.parametrize("driver", ["cm_dma", "cm_icap", "cm_plsim_dma"])
def test_a_driver_is_unbound_under_open_files(driver: str) -> None:
    folder = Path("/sys/bus/platform/drivers", driver)
    name = next(link.name for link in folder.iterdir() if link.is_symlink() and link.name != "module")
    with device.AxiDma.open("from_pl") as channel, channel.allocate(4096) as target, device.Icap.open() as port:
        channel.submit(target, length=4096)
        (folder / "unbind").write_text(name)
        # an engine takes the drivers with it that use its channels
        assert bool(device.list_dma()) == (driver == "cm_icap")
        assert bool(device.list_icap()) == (driver == "cm_dma")
        if not device.list_dma():
            with pytest.raises(device.DeviceError):
                channel.submit(target, length=4096)
        if not device.list_icap():
            with pytest.raises(device.DeviceError):
                port.allocate(4096)
        with contextlib.suppress(device.DeviceError):
            channel.cancel()
    (folder / "bind").write_text(name)
    until(lambda: "from_pl" in device.list_dma() and device.list_icap())
    loop()
    with plsim.nothing():  # regions keep the manager that they found first
        pass
