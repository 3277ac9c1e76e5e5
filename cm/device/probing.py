# SPDX-License-Identifier: Apache-2.0
"""Whether drivers were bound to the devices that an overlay brought: "applied" says only that the tree changed.

A driver's probe may fail, most often with -16, as an interrupt or a window belongs to another device. The kernel tells
nobody but its log; `drivers_probe` and modprobe succeed all the same. So the `driver` link is looked at.
"""

from __future__ import annotations

import errno
import os
import re
import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from cm.device.attributes import Attributes
from cm.device.checks.machine import Machine, PlatformDevice
from cm.device.errors import DeviceError
from cm.device.paths import Root

_BUS = "sys/bus/platform"
_PATIENCE = 5.0  # seconds: a supplier, or a module that udev loads, may come a little later
_PAUSE = 0.02
# Modules whose driver on the bus is called otherwise.
_NAMES = {"xilinx_dma": "xilinx-vdma", "xilinx_pr_decoupler": "xlnx_pr_decoupler"}
_LEFT_ALONE = "of_fpga_region"  # regions of no importance to us wait for a manager that may not be there
_UIO, _LENDER = "uio_pdrv_genirq", "cm_window"
_LOG_BYTES = 1 << 13  # no record of the kernel's log is longer


def device_names(root: Root) -> frozenset[str]:
    """Devices of the platform bus."""
    try:
        return frozenset(os.listdir(f"{root.prefix}/{_BUS}/devices"))  # noqa: PTH208 (names, before and after each overlay)
    except OSError:
        return frozenset()


def await_drivers(root: Root, before: Collection[str], overlay: str) -> None:
    """Wait until the devices that came since `before` have their drivers, as far as any driver there takes them.

    Raises DeviceError with each device, its driver, the kernel's reason, and who holds its interrupt or window.
    """
    new = device_names(root).difference(before)
    until = time.monotonic() + _PATIENCE
    while unbound := [device for device in Machine(root).devices_named(new) if _drivers(root, device)]:
        if time.monotonic() >= until or root.simulated:
            said = "; ".join(_reason(root, device) for device in unbound)
            path = str(root.join(_BUS, "devices", unbound[0].name))
            raise DeviceError(errno.EBUSY, f"overlay {overlay} was applied, but {said}", path)
        time.sleep(_PAUSE)


def hand_over_windows(root: Root, before: Collection[str]) -> None:
    """Give cm_window the register windows that came since `before` and that uio_pdrv_genirq took.

    That one is asked first where it is built into the kernel with an of_id of ours, as PYNQ's is, and lends nothing.
    Where that may not be written, or cm_window does not take one, the window stays as it is.
    """
    if not root.join(_BUS, "drivers", _LENDER).exists():
        return
    for device in Machine(root).devices_named(device_names(root).difference(before)):
        if device.driver == _UIO and "fpga-cm,window" in device.compatible:
            with suppress(DeviceError):
                _rebind(root, device.name, _LENDER)


def _rebind(root: Root, name: str, driver: str) -> None:
    bus, override = Attributes(root, _BUS), f"devices/{name}/driver_override"
    bus.write(override, f"{driver}\n".encode())
    bus.write(f"drivers/{_UIO}/unbind", name.encode())
    bus.write("drivers_probe", name.encode())
    if any(not device.driver for device in Machine(root).devices_named([name])):
        bus.write(override, b"\n")
        bus.write("drivers_probe", name.encode())


def _drivers(root: Root, device: PlatformDevice) -> list[str]:
    """The drivers that are there and should be bound to a device; none where one is."""
    if device.driver:
        return []
    from cm.device.checks.devices import DRIVERS  # here: only who waits for a driver needs it

    modules = dict.fromkeys(DRIVERS[name] for name in device.compatible if name in DRIVERS)
    names = [_NAMES.get(module, module) for module in modules if module != _LEFT_ALONE]
    return [name for name in names if root.join(_BUS, "drivers", name).exists()]


def _reason(root: Root, device: PlatformDevice) -> str:
    drivers = " or ".join(_drivers(root, device))
    text = f"{device.name} ({device.compatible[0]}) got no driver: {drivers} did not take it"
    if holders := [f"{holder.name} ({holder.driver}) has its {what}" for holder, what in _holders(root, device)]:
        free = [f"echo {h.name} >/{_BUS}/drivers/{h.driver}/unbind" for h, _ in _holders(root, device)]
        return f"{text}, as {' and '.join(holders)}: {'; '.join(dict.fromkeys(free))}"
    if Machine(root).text(_BUS, "devices", device.name, "waiting_for_supplier") == "1":
        return f"{text}, as it waits for a device of its node (clocks, dmas, fpga-mgr) that has no driver either"
    if said := _log(root, device.name):
        return f"{text}: the kernel says {' / '.join(said)}"
    hint = "; the driver's of_id has to be one of the node's compatible strings" if "uio" in drivers else ""
    return f"{text}; dmesg | grep {device.name} says why{hint}"


def _holders(root: Root, device: PlatformDevice) -> Iterator[tuple[PlatformDevice, str]]:
    """Devices with a driver that have an interrupt or the window of another."""
    mine = _interrupts(device.path / "of_node")
    for other in Machine(root).devices:
        if other.name == device.name or not other.driver:
            continue
        if mine & _interrupts(other.path / "of_node"):
            yield other, "interrupt"
        if device.base is not None and device.base == other.base:
            yield other, "window"


def _interrupts(node: Path) -> set[bytes]:
    """Kind and number of each interrupt of the GIC (three cells), also of a node's children: channels of an engine."""
    found = set[bytes]()
    for file in (node / "interrupts", *node.glob("*/interrupts")):
        try:
            cells = file.read_bytes()
        except OSError:
            continue
        found |= {cells[at : at + 8] for at in range(0, len(cells), 12)} if len(cells) % 12 == 0 else set()
    return found


def _log(root: Root, name: str) -> list[str]:
    """The last lines of the kernel's log about a device, where we may read it."""
    lines: list[str] = []
    try:
        log = os.open(root.join("dev/kmsg"), os.O_RDONLY | os.O_NONBLOCK)
    except OSError:
        return lines
    try:
        while record := os.read(log, _LOG_BYTES):
            lines.append(record.decode("utf-8", "replace").partition(";")[2].splitlines()[0])
    except OSError:  # EAGAIN: that was the last one; EPIPE: the log overran us
        pass
    finally:
        os.close(log)
    short = name.partition(".")[2] or name
    return [line for line in lines if re.search(rf"\b{re.escape(short)}\b", line)][-3:]
