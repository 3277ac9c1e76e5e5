# SPDX-License-Identifier: Apache-2.0
"""Between PS and PL: widths of the ports, clocks."""

from __future__ import annotations

from collections.abc import Iterator

from cm.device.check_result import Finding, State
from cm.device.checks.machine import Machine

_AFI = ("xlnx,afi-fpga", "xlnx,zynq-afi-fpga")


def checks(machine: Machine) -> Iterator[Finding]:
    """Widths and clocks."""
    yield from _widths(machine)
    yield from _clocks(machine)


def _widths(machine: Machine) -> Iterator[Finding]:
    for device in machine.devices:
        if not any(name in _AFI for name in device.compatible):
            continue
        if device.driver:
            yield Finding("afi", device.name, str(device.path), State.OK, "set by the kernel")
            continue
        advice = (
            "this kernel has no driver for it (linux-xlnx has): the widths stay those of the boot loader; a design "
            "whose ports differ moves wrong bytes, so boot with the XSA of a design with the same ports"
        )
        yield Finding("afi", device.name, str(device.path), State.WRONG, "no driver sets the ports' widths", advice)


def _clocks(machine: Machine) -> Iterator[Finding]:
    folder = "sys/class/cm_clock"
    names = machine.names(folder)
    for name in names:
        rate = machine.text(folder, name, "rate")
        path = str(machine.root.join(folder, name))
        if rate.isdecimal():
            running = machine.text(folder, name, "enable") != "0"
            detail = f"{int(rate) / 1e6:.6f} MHz" + ("" if running else ", not held running by cm_clock")
            yield Finding("clock", name, path, State.OK, detail)
        else:
            yield Finding("clock", name, path, State.DENIED, "its rate cannot be read", "run as root, or see dmesg")
    if not names:
        advice = (
            "the PL runs at what the boot loader left: modprobe cm_clock, and apply an overlay with an fpga-cm,clocks "
            "node (those of cm build have one)"
        )
        yield Finding("clock", "clocks", str(machine.root.join(folder)), State.MISSING, "none can be set", advice)
