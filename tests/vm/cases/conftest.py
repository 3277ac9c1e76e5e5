# SPDX-License-Identifier: Apache-2.0
"""What this board can do, seen by looking; a test that needs more is skipped, or fails where it was promised."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path

import pytest


def _module(name: str) -> bool:
    return any(Path("/lib/modules", os.uname().release).rglob(f"{name}.ko*"))


def _log_says(text: str) -> bool:
    return text in os.popen("dmesg").read()


LOOK: dict[str, Callable[[], bool]] = {
    "cm": lambda: importlib.util.find_spec("cm") is not None,
    "dma": lambda: _module("cm_dma"),
    "plsim": lambda: _module("cm_plsim"),
    "uio": lambda: Path("/sys/class/uio").exists(),
    "overlay": lambda: _module("cm_overlay") and Path("/proc/device-tree/__symbols__").exists(),
    "fpga": lambda: Path("/sys/class/fpga_manager").exists(),
    "uio_genirq": lambda: _module("uio_pdrv_genirq"),
    "kunit": lambda: _module("kunit"),
    "lockdep": lambda: Path("/proc/lockdep").exists(),
    "dma_debug": lambda: Path("/sys/kernel/debug/dma-api").exists(),
    "kasan": lambda: _log_says("KernelAddressSanitizer initialized"),
    "kmemleak": lambda: os.access("/sys/kernel/debug/kmemleak", os.W_OK),
    "kvm": lambda: _log_says("Hypervisor detected: KVM"),
}
EXPECTED = set(filter(None, os.environ.get("CM_VM_EXPECTS", "").split(",")))


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "needs(*capabilities): what the board must have")


def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("needs"):
        for name in mark.args:
            if LOOK[name]():
                continue
            if name in EXPECTED:
                pytest.fail(f"this board was promised to have {name}")
            pytest.skip(f"needs {name}")


@pytest.fixture(scope="session")
def expected() -> set[str]:
    """The capabilities promised for this board."""
    return EXPECTED
