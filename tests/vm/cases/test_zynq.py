# SPDX-License-Identifier: Apache-2.0
"""A Zynq-7000's own drivers of mainline: zynq-fpga behind regions, PL clocks, UIO; on Debian's 32-bit ARM."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from served import until

from cm import device
from cm.formats import fdt

pytestmark = pytest.mark.needs("zynq", "overlay", "fpga", "uio_genirq")
FIRMWARE = Path("/lib/firmware")
PLATFORM = Path("/sys/bus/platform/devices")
NAME = "zynq-test"
FULL = "/fpga-full"
WINDOW = 0x43C00000  # behind M_AXI_GP0
SPI = 29  # IRQ_F2P[0]
CLOCKS = Path("/sys/class/cm_clock")
SYNC, NOOP, PAD = 0xAA995566, 0x20000000, 0xFFFFFFFF


@pytest.fixture
def overlays() -> Iterator[device.Overlays]:
    there = device.Overlays("/")
    yield there
    for name in reversed(there.list()):
        there.remove(name)


def image(size: int, order: str = "<") -> bytes:
    """Words that the driver takes for a bitstream: it looks for the sync word, in the order of PCAP."""
    words = [*[PAD] * 8, 0x000000BB, 0x11220044, *[PAD] * 2, SYNC]
    words += [NOOP] * (size // 4 - len(words))
    return struct.pack(f"{order}{len(words)}I", *words)


def region(content: dict[str, bytes], children: list[fdt.FdtNode] | None = None) -> bytes:
    return fdt.pack(fdt.overlay(FULL, fdt.FdtNode("", content, children or [])))


def manager() -> device.FpgaManager:
    return device.FpgaManager(0, "/")


def interrupts(name: str) -> int:
    """How often a device's line was served."""
    lines = [line.split() for line in Path("/proc/interrupts").read_text().splitlines() if line.rstrip().endswith(name)]
    return sum(int(words[1]) for words in lines)


def phandle(label: str) -> bytes:
    path = Path("/proc/device-tree/__symbols__", label).read_text().rstrip("\0")
    return Path("/proc/device-tree" + path, "phandle").read_bytes()


def cells(*values: int) -> bytes:
    return struct.pack(f">{len(values)}I", *values)


# the port


@pytest.mark.parametrize("size", [64 << 10, 4 << 20])
def test_a_full_bitstream_goes_through_devcfg_and_its_interrupt(overlays: device.Overlays, size: int) -> None:
    (FIRMWARE / "full.bin").write_bytes(image(size))
    before = interrupts("f8007000.devcfg")
    overlays.apply(NAME, region({"firmware-name": b"full.bin\0"}))
    assert manager().state == "operating"
    assert interrupts("f8007000.devcfg") > before


def test_a_partial_bitstream_does_too(overlays: device.Overlays) -> None:
    (FIRMWARE / "part.bin").write_bytes(image(64 << 10))
    overlays.apply(NAME, region({"firmware-name": b"part.bin\0", "partial-fpga-config": b""}))
    assert manager().state == "operating"


def test_a_bitstream_in_the_wrong_order_of_bytes_is_refused(overlays: device.Overlays) -> None:
    (FIRMWARE / "wrong.bin").write_bytes(image(64 << 10, ">"))
    with pytest.raises(device.DeviceError):
        overlays.apply(NAME, region({"firmware-name": b"wrong.bin\0"}))
    assert "error" in manager().state


def test_a_bitstream_that_is_not_there_is_refused_and_the_next_one_is_loaded(overlays: device.Overlays) -> None:
    with pytest.raises(device.DeviceError):
        overlays.apply(NAME, region({"firmware-name": b"nowhere.bin\0"}))
    assert "error" in manager().state
    (FIRMWARE / "full.bin").write_bytes(image(64 << 10))
    overlays.apply(NAME, region({"firmware-name": b"full.bin\0"}))
    assert manager().state == "operating"


def test_the_devices_of_a_region_come_with_its_bitstream_and_go(overlays: device.Overlays) -> None:
    (FIRMWARE / "full.bin").write_bytes(image(64 << 10))
    child = fdt.FdtNode("pl@43c00000", {"compatible": b"fpga-cm,uio\0", "reg": cells(WINDOW, 0x1000)})
    overlays.apply(NAME, region({"firmware-name": b"full.bin\0"}, [child]))
    assert (PLATFORM / "43c00000.pl/driver").readlink().name == "uio_pdrv_genirq"
    with device.Uio.open(WINDOW) as window:
        window.write(0x10, 0x12345678)
        assert window.read(0x10) == 0x12345678
    overlays.remove(NAME)
    assert not (PLATFORM / "43c00000.pl").exists()


# interrupts


def test_an_interrupt_of_the_pl_reaches_user_space_and_is_masked_until_it_is_asked_for(
    overlays: device.Overlays,
) -> None:
    properties = {"compatible": b"fpga-cm,uio\0", "reg": cells(WINDOW, 0x1000)}
    properties |= {"interrupt-parent": phandle("intc"), "interrupts": cells(0, SPI, 4)}
    overlays.apply(NAME, fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [fdt.FdtNode("pl@43c00000", properties)]))))
    line = next(
        words[0].rstrip(":")
        for words in map(str.split, Path("/proc/interrupts").read_text().splitlines())
        if words[-1] == "pl"
    )
    trigger = Path("/sys/kernel/debug/irq/irqs", line)
    node = device.find_uio(WINDOW, 4)[0].node
    with device.Uio.open(node) as window:
        window.enable_interrupt()
        for count in (1, 2):
            trigger.write_text("trigger")
            assert window.wait(10.0) == count
            window.enable_interrupt()


# clocks


@pytest.fixture
def clocks(overlays: device.Overlays) -> device.Overlays:
    """fclk0 to fclk3 through our module."""
    clkc = struct.unpack(">I", phandle("clkc"))[0]
    properties = {
        "compatible": b"fpga-cm,clocks\0",
        "clocks": cells(*(word for index in range(15, 19) for word in (clkc, index))),
        "clock-names": b"fclk0\0fclk1\0fclk2\0fclk3\0",
        "assigned-clocks": cells(clkc, 16),
        "assigned-clock-rates": cells(50_000_000),
    }
    overlays.apply(NAME, fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [fdt.FdtNode("pl-clocks", properties)]))))
    until((CLOCKS / "fclk3").exists)
    return overlays


def kernel_says(clock: str, name: str) -> int:
    """What the kernel's own clock framework says of a clock."""
    return int(Path("/sys/kernel/debug/clk", clock, name).read_text())


def test_the_pl_clocks_are_set_and_read_back(clocks: device.Overlays) -> None:
    for name, rate in (("fclk0", 100_000_000), ("fclk2", 142_860_000)):
        (CLOCKS / name / "rate").write_text(str(rate))
        got = int((CLOCKS / name / "rate").read_text())
        assert got == kernel_says(name, "clk_rate")
        assert 0.98 * rate < got <= rate  # the dividers round down


def test_an_assigned_rate_is_in_force(clocks: device.Overlays) -> None:
    assert int((CLOCKS / "fclk1/rate").read_text()) == pytest.approx(50_000_000, rel=0.001)


def test_a_rate_can_be_asked_for_before_it_is_set(clocks: device.Overlays) -> None:
    before = (CLOCKS / "fclk3/rate").read_text()
    (CLOCKS / "fclk3/round").write_text("142860000")
    rounded = int((CLOCKS / "fclk3/round").read_text())
    assert (CLOCKS / "fclk3/rate").read_text() == before
    (CLOCKS / "fclk3/rate").write_text("142860000")
    assert int((CLOCKS / "fclk3/rate").read_text()) == rounded


def test_a_gate_opens_and_closes(clocks: device.Overlays) -> None:
    (CLOCKS / "fclk3/enable").write_text("1")
    assert kernel_says("fclk3", "clk_enable_count") == 1
    (CLOCKS / "fclk3/enable").write_text("0")
    assert kernel_says("fclk3", "clk_enable_count") == 0


def for_uio(name: str, address: int) -> bytes:
    """A node for UIO with the first interrupt of the PL, as PYNQ's images have one and cm build writes one."""
    properties = {"compatible": b"fpga-cm,uio\0generic-uio\0", "reg": cells(address, 0x1000)}
    properties |= {"interrupt-parent": phandle("intc"), "interrupts": cells(0, SPI, 4)}
    node = fdt.FdtNode(f"{name}@{address:x}", properties)
    return fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [node])))


def test_an_interrupt_that_the_image_has_given_away_fails_the_overlay_and_is_freed_by_what_is_said(
    overlays: device.Overlays,
) -> None:
    fabric, control = "43c00000.fabric", "43c10000.cm-control"
    overlays.apply("image", for_uio("fabric", WINDOW))
    with pytest.raises(device.DeviceError) as refused:
        overlays.apply(NAME, for_uio("cm-control", WINDOW + 0x10000))
    said = str(refused.value)
    assert f"{control} (fpga-cm,uio) got no driver" in said
    assert f"{fabric} (uio_pdrv_genirq) has its interrupt" in said
    assert overlays.list() == ["image"]
    what, _, where = said.rpartition("echo ")[2].partition(" >")
    assert (what, where) == (fabric, "/sys/bus/platform/drivers/uio_pdrv_genirq/unbind")
    Path(where).write_text(what)
    overlays.apply(NAME, for_uio("cm-control", WINDOW + 0x10000))
    assert (PLATFORM / control / "driver").readlink().name == "uio_pdrv_genirq"


# what programs see


def test_seconds_have_64_bits_on_32_bit_arm() -> None:
    assert ctypes.sizeof(ctypes.c_void_p) == 4
    assert ctypes.sizeof(ctypes.c_time_t) == 8
