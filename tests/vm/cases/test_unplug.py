# SPDX-License-Identifier: Apache-2.0
"""What goes away while it is used, and all of it going away and coming back."""

from __future__ import annotations

import contextlib
import errno
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import plsim
import pytest
from capabilities import LOOK
from served import PATIENCE, until

from cm import device

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
MODULES = ("cm_axidma_compat", "cm_plsim", "cm_icap", "cm_window", "cm_dma")  # in the order in which they can go


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
        # it comes after cm_window again, which has the nodes that both know
        beside = [name for name in ("uio_pdrv_genirq",) if Path("/sys/module", name).exists()]
        for name in (*beside, *MODULES):
            modules("rmmod", name)
            assert not Path("/sys/module", name).exists()
        modules("modprobe", "-a", *reversed(MODULES[1:]))
        for name in beside:
            modules("modprobe", name, "of_id=fpga-cm,uio")
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


@contextlib.contextmanager
def unbound(driver: str, name: str) -> Iterator[None]:
    """Without a device's driver, as an administrator takes it away."""
    folder = Path("/sys/bus/platform/drivers", driver)
    (folder / "unbind").write_text(name)
    try:
        yield
    finally:
        (folder / "bind").write_text(name)


def load_ends(tmp_path: Path) -> int:
    """Load a bitstream through the only port; gives the verdict."""
    with plsim.loading(tmp_path) as end:
        return end().status


def test_a_port_asks_the_engine_that_is_there_now(tmp_path: Path) -> None:
    channels = {"icap": {"kind": "icap", "idcode": "0x03727093", "timeout_ms": 600_000}}
    with plsim.nothing(), plsim.board(channels, {}) as engine:
        assert load_ends(tmp_path) == 0
        for _ in range(3):
            with unbound("cm_plsim_dma", engine.name):
                assert device.list_icap() == []
            until(device.list_icap)
            assert load_ends(tmp_path) == 0
            (engine / "icap/inject_errors").write_text("1")  # CM_ICAP_ERR_CRC
            assert load_ends(tmp_path) == -errno.EILSEQ


def test_what_was_mapped_for_an_engine_is_not_when_it_has_no_driver_and_the_pages_stay() -> None:
    mapped = Path("/sys/kernel/debug/cm_dma/mapped")
    with plsim.nothing(), plsim.board({"camera": {}}, {}) as engine, device.AxiDma.open("camera") as channel:
        before = int(mapped.read_text())
        with channel.allocate(8192) as buffer, channel.allocate(4096) as other:
            assert int(mapped.read_text()) == before + 2
            words = buffer.array().view(np.uint32)
            words[:] = 7
            with unbound("cm_plsim_dma", engine.name):
                assert int(mapped.read_text()) == 0
                assert (words == 7).all()
                assert other.length == 4096
                words[:] = 8
            assert (words == 8).all()
        until(lambda: "camera" in device.list_dma())


@pytest.fixture
def limits() -> Iterator[Path]:
    """The parameters of cm_dma, afterwards as they were."""
    folder = Path("/sys/module/cm_dma/parameters")
    before = {name: (folder / name).read_text() for name in ("limit_mb", "file_limit_mb")}
    yield folder
    for name, value in before.items():
        (folder / name).write_text(value)


def test_the_memory_of_a_file_and_of_all_files_has_a_limit(limits: Path) -> None:
    allocated = Path("/sys/kernel/debug/cm_dma/allocated")
    before = int(allocated.read_text())
    with plsim.nothing(), plsim.board({"camera": {}, "display": {}}, {}):
        (limits / "file_limit_mb").write_text("1")
        with device.AxiDma.open("camera") as channel, device.AxiDma.open("display") as other:
            with pytest.raises(device.DeviceError) as refused:
                channel.allocate((1 << 20) + 1)
            assert refused.value.errno == errno.ENOMEM
            kept = channel.allocate(1 << 20)
            with pytest.raises(device.DeviceError):
                channel.allocate(4096)
            other.allocate(4096).close()  # which has a limit of its own
            (limits / "limit_mb").write_text(str((before >> 20) + 1))
            with pytest.raises(device.DeviceError):
                other.allocate(1 << 20)
            kept.close()
            until(lambda: int(allocated.read_text()) == before)  # the memory counts until it is gone
            other.allocate(1 << 20).close()


@pytest.fixture
def pool() -> Iterator[str]:
    """A channel with 16 MB of its own for buffers; gives the name of its device."""
    overlays = device.Overlays("/")
    overlays.apply("pool", plsim.overlay("pool"))
    try:
        yield "pool-channels"
    finally:
        overlays.remove("pool")


def unbind_over(buffer: device.DmaBuffer, name: str) -> None:
    """Take the driver of a buffer's device away and bring it back; the buffer must stay as it was."""
    words = buffer.array().view(np.uint32)
    words[:] = np.arange(len(words), dtype=np.uint32)
    with unbound("cm_dma", name):
        assert "pool" not in device.list_dma()
    until(lambda: "pool" in device.list_dma())
    # bound anew, and the old buffer still has its part of the pool
    with device.AxiDma.open("pool") as again, pytest.raises(device.DeviceError):
        again.allocate(buffer.length)
    assert np.array_equal(words, np.arange(len(words), dtype=np.uint32))


@pytest.mark.needs("overlay")
def test_reserved_memory_outlives_its_driver_and_comes_back(pool: str) -> None:
    most = 10 << 20
    for _ in range(3):
        with device.AxiDma.open("pool") as channel, channel.allocate(most) as buffer:
            with pytest.raises(device.DeviceError):
                channel.allocate(most)  # the kernel's own would have room
            unbind_over(buffer, pool)
    with device.AxiDma.open("pool") as channel, channel.allocate(4096) as buffer:
        channel.submit(buffer, length=4096)
        assert channel.wait(PATIENCE).length == 4096
