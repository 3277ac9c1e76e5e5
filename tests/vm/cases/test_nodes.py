# SPDX-License-Identifier: Apache-2.0
"""Overlays of the shape that `cm build` and dts/ give them: every node gets a device and a driver, and goes."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from plsim import remove_overlays

from cm import device
from cm.device.checks import devices
from cm.device.checks.machine import Machine
from cm.device.paths import Root
from cm.formats import fdt

pytestmark = pytest.mark.needs("overlay", "uio_genirq", "plsim")
NAME = "nodes-test"
PLATFORM = Path("/sys/bus/platform/devices")
NOBODY = 0x0B000000  # between two devices of QEMU's virt machine: an external abort
READ_NOBODY = f"""
import errno
from cm import device
with device.Uio.open({NOBODY}) as nobody, device.Uio.open(0x58005000) as flat:
    for access in (lambda: nobody.read(0), lambda: nobody.read_block(16, 8)):
        try:
            access()
        except device.DeviceError as error:
            print(errno.errorcode[error.errno])
    flat.write(0, 5)
    print(flat.read(0))
"""
FLAT, BELOW = 0x58005000, 0x58006000  # in the memory that the tree sets aside for windows


def window(name: str, address: int) -> fdt.FdtNode:
    """A register window as the templates of `cm build` write it."""
    reg = struct.pack(">QQ", address, 0x1000)
    return fdt.FdtNode(f"{name}@{address:x}", {"compatible": b"fpga-cm,uio\0generic-uio\0", "reg": reg})


def new_bus(child: fdt.FdtNode) -> fdt.FdtNode:
    """What overlays must not do: a bus of their own with the devices below it."""
    cells = struct.pack(">I", 2)
    properties = {"compatible": b"simple-bus\0", "#address-cells": cells, "#size-cells": cells, "ranges": b""}
    return fdt.FdtNode("a-bus-of-its-own", properties, [child])


@pytest.fixture
def overlays() -> Iterator[device.Overlays]:
    remove_overlays()
    yield device.Overlays("/")
    remove_overlays()


def driver(name: str) -> str:
    link = PLATFORM / name / "driver"
    return link.readlink().name if link.is_symlink() else ""


def test_every_node_of_the_static_overlay_has_its_driver() -> None:
    unbound = [finding for finding in devices.checks(Machine(Root("/"))) if finding.kind == "unbound"]
    assert unbound == []


def test_a_node_on_a_bus_that_was_there_is_bound_and_goes_with_the_overlay(overlays: device.Overlays) -> None:
    content = fdt.FdtNode("", {}, [window("flat", FLAT)])
    overlays.apply(NAME, fdt.pack(fdt.overlay("/", content)))
    assert driver(f"{FLAT:x}.flat") == "uio_pdrv_genirq"
    assert device.find_uio(FLAT, 4)[0].name == "flat"
    overlays.remove(NAME)
    assert not (PLATFORM / f"{FLAT:x}.flat").exists()


def test_a_node_below_a_bus_that_the_overlay_brings_gets_no_device(overlays: device.Overlays) -> None:
    """Why the templates put every node on a bus that is there at boot."""
    content = fdt.FdtNode("", {}, [new_bus(window("below", BELOW))])
    overlays.apply(NAME, fdt.pack(fdt.overlay("/", content)))
    assert (PLATFORM / "a-bus-of-its-own").exists()
    assert not (PLATFORM / f"{BELOW:x}.below").exists()


def test_a_register_that_nobody_answers_for_is_an_error_and_not_the_end(overlays: device.Overlays) -> None:
    """In a process of its own: before, SIGBUS ended it."""
    content = fdt.FdtNode("", {}, [window("nobody", NOBODY), window("flat", FLAT)])
    overlays.apply(NAME, fdt.pack(fdt.overlay("/", content)))
    done = subprocess.run([sys.executable, "-c", READ_NOBODY], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["EIO", "EIO", "5"]), done.stderr


def test_a_region_has_the_name_that_the_binding_allows() -> None:
    names = [path.name for path in Path("/proc/device-tree/pl-bus").glob("fpga-region*")]
    assert sorted(names) == ["fpga-region-0", "fpga-region-1"]
