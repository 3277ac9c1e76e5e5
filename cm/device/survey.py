# SPDX-License-Identifier: Apache-2.0
"""What a machine has, what it lacks, and what to do about it: the facts behind ``cm doctor``.

Nothing is opened: an exclusive device that is in use counts as well as a free one, and the survey must not disturb it.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from cm.device import advice
from cm.device.axidma import FOLDER as DMA_FOLDER
from cm.device.axidma import list_dma
from cm.device.base import AnyRoot
from cm.device.check_result import Finding, State
from cm.device.checks import board_checks
from cm.device.checks.kernel import modules
from cm.device.errors import DeviceError
from cm.device.fpga_manager import CLASS as FPGA_CLASS
from cm.device.fpga_manager import FpgaManager, list_fpga_managers
from cm.device.icap import list_icap
from cm.device.overlays import FOLDER as OVERLAY_FOLDER
from cm.device.overlays import Overlays
from cm.device.paths import Root
from cm.device.uio import list_uio
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Survey:
    """All findings under one root."""

    root: str
    simulated: bool
    findings: tuple[Finding, ...]

    def of(self, kind: str) -> tuple[Finding, ...]:
        """Return the findings of one kind."""
        return tuple(finding for finding in self.findings if finding.kind == kind)

    @property
    def usable(self) -> bool:
        """Whether nothing that exists is denied, and there is a way to configure the PL."""
        ways = [*self.of("icap"), *self.of("fpga_manager"), *self.of("overlays")]
        denied = any(finding.state is State.DENIED for finding in self.findings)
        return not denied and any(finding.state is State.OK for finding in ways)


def survey(root: AnyRoot = None) -> Survey:
    """Look at everything there is under ``root``; never raises for what is missing or denied."""
    base = Root.of(root)
    findings = (*_uio(base), *_dma(base), *_icap(base), _overlays(base), *_fpga_managers(base), *modules(base))
    findings = (*findings, *board_checks(base))
    return Survey(base.path, base.simulated, findings)


def _node(kind: str, name: str, path: Path, detail: str, root: Root) -> Finding:
    """Return the finding for a device node that is listed somewhere."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        return Finding(kind, name, str(path), State.MISSING, detail, advice.unopened(error, root, path, ()))
    if not (stat.S_ISCHR(mode) or stat.S_ISSOCK(mode)):
        return Finding(kind, name, str(path), State.MISSING, detail, "this is neither a device nor a simulated one")
    if not os.access(path, os.R_OK | os.W_OK):
        return Finding(kind, name, str(path), State.DENIED, detail, advice.permission(path))
    return Finding(kind, name, str(path), State.OK, detail)


def _none(kind: str, name: str, path: Path, hint: str) -> Finding:
    return Finding(kind, name, str(path), State.MISSING, "none found", hint)


def _uio(root: Root) -> Iterator[Finding]:
    try:
        infos = list_uio(root)
    except DeviceError as error:
        yield Finding("uio", "uio", str(root.join("sys/class/uio")), State.DENIED, "", str(error))
        return
    for info in infos:
        maps = ", ".join(f"0x{m.address:x}+0x{m.size:x}" for m in info.maps) or "no map"
        yield _node("uio", info.name, root.join("dev", info.node), maps, root)
    if not infos:
        hint = "load uio_pdrv_genirq with of_id= set to the compatible of your register windows (docs/device.md)"
        yield _none("uio", "uio", root.join("dev"), hint)


def _dma(root: Root) -> Iterator[Finding]:
    names = list_dma(root)
    for name in names:
        yield _node("dma", name, root.join(DMA_FOLDER, name), "", root)
    if not names:
        hint = "load cm_dma and give the device tree its client nodes (docs/kernel.md)"
        yield _none("dma", "dma", root.join(DMA_FOLDER), hint)


def _icap(root: Root) -> Iterator[Finding]:
    names = list_icap(root)
    for name in names:
        yield _node("icap", name, root.join("dev", name), "", root)
    if not names:
        hint = "load cm_icap if the design has an ICAP; without one, loads go through the fpga_manager or overlays"
        yield _none("icap", "icap", root.join("dev"), hint)


def _overlays(root: Root) -> Finding:
    path = root.join(OVERLAY_FOLDER)
    if not Overlays(root).available():
        hint = "mount configfs, and use linux-xlnx with OF_CONFIGFS, our cm_overlay module, or dtbocfg"
        return _none("overlays", "overlays", path, hint)
    applied = f"{len(Overlays(root).list())} there"
    if os.access(path, os.W_OK | os.X_OK):
        return Finding("overlays", "overlays", str(path), State.OK, applied)
    return Finding(
        "overlays", "overlays", str(path), State.DENIED, applied, "configfs is for root: run the manager as root"
    )


def _fpga_managers(root: Root) -> Iterator[Finding]:
    names = list_fpga_managers(root)
    for name in names:
        yield _fpga_manager(root, name)
    if not names:
        hint = "the kernel needs FPGA and the driver of this device (zynq-fpga, zynqmp-fpga, versal-fpga)"
        yield _none("fpga_manager", "fpga_manager", root.join(FPGA_CLASS), hint)


def _fpga_manager(root: Root, name: str) -> Finding:
    path = root.join(FPGA_CLASS, name)
    number = name.removeprefix("fpga")
    manager = FpgaManager(int(number) if number.isdecimal() else 0, root)
    try:
        detail = f"{manager.name}, {manager.state}"
    except DeviceError as error:
        return Finding("fpga_manager", name, str(path), State.DENIED, "", str(error))
    if not manager.can_load:
        hint = "this kernel loads through overlays only (linux-xlnx has a firmware attribute)"
        return Finding("fpga_manager", name, str(path), State.OK, f"{detail}, no firmware attribute", hint)
    if not os.access(path / "firmware", os.W_OK):
        return Finding("fpga_manager", name, str(path), State.DENIED, detail, advice.permission(path / "firmware"))
    return Finding("fpga_manager", name, str(path), State.OK, detail)
