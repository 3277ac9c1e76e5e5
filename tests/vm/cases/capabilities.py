# SPDX-License-Identifier: Apache-2.0
"""What this board can do, seen by looking, and what was promised of it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
from collections.abc import Callable
from pathlib import Path


def _module(name: str) -> bool:
    return any(Path("/lib/modules", os.uname().release).rglob(f"{name}.ko*"))


def kernel_log() -> str:
    """What the kernel has said so far."""
    return subprocess.run(["dmesg"], capture_output=True, text=True, check=True).stdout


def _log_says(text: str) -> bool:
    return text in kernel_log()


LOOK: dict[str, Callable[[], bool]] = {
    "cm": lambda: importlib.util.find_spec("cm") is not None,
    "dma": lambda: _module("cm_dma"),
    "plsim": lambda: _module("cm_plsim"),
    "uio": lambda: Path("/sys/class/uio").exists(),
    "overlay": lambda: _module("cm_overlay") and Path("/proc/device-tree/__symbols__").exists(),
    "board_overlay": lambda: Path("/sys/kernel/config/device-tree/overlays/static").exists(),
    "zynq": lambda: Path("/sys/bus/platform/drivers/zynq_fpga_manager").exists(),
    "fpga": lambda: Path("/sys/class/fpga_manager").exists(),
    "uio_genirq": lambda: _module("uio_pdrv_genirq"),
    "kunit": lambda: _module("kunit"),
    "lockdep": lambda: Path("/proc/lockdep").exists(),
    "dma_debug": lambda: Path("/sys/kernel/debug/dma-api").exists(),
    "kasan": lambda: _log_says("KernelAddressSanitizer initialized"),
    "kmemleak": lambda: "kmemleak=on" in Path("/proc/cmdline").read_text(),
    "xilinx_dma": lambda: Path("/sys/kernel/debug/cm_axi").exists(),  # the kernel's own, on modelled engines
    "highmem": lambda: "HighTotal" in Path("/proc/meminfo").read_text(),
    "suspend": lambda: Path("/sys/power/pm_test").exists() and Path("/sys/kernel/tracing").exists(),
    "kvm": lambda: _log_says("Hypervisor detected: KVM"),
}
EXPECTED = set(filter(None, os.environ.get("CM_VM_EXPECTS", "").split(",")))
