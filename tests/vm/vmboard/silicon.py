# SPDX-License-Identifier: Apache-2.0
"""Xilinx' drivers, unmodified, under models of their engines: those of the kernel that runs, and of others."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from vmboard.arch import host
from vmboard.cache import Cache
from vmboard.errors import VmError
from vmboard.kernel import Kernel
from vmboard.packages import Apt, unpack
from vmboard.paths import REPOSITORY
from vmboard.shell import run

MODEL = REPOSITORY / "tests/vm/silicon"
DRIVER = "drivers/dma/xilinx/xilinx_dma.c"


@dataclass(frozen=True, slots=True)
class Source:
    """A source package of a Debian release, for one driver of its kernel."""

    suite: str
    package: str

    def driver(self, cache: Cache) -> Path:
        """The driver's file, or `$CM_VM_DRIVER` in its place. Raises VmError where it cannot be had."""
        chosen = os.environ.get("CM_VM_DRIVER")
        if chosen:
            return Path(chosen).resolve()
        place = cache.entry(f"driver-{self.package}", [self.suite, self.package], lambda out: self._fetch(cache, out))
        return place / "xilinx_dma.c"

    def _fetch(self, cache: Cache, place: Path) -> None:
        unpack(Apt(cache.root, host(), self.suite).download([self.package], place / "debs"), place / "package")
        packed = place / "package/usr/src" / f"{self.package}.tar.xz"
        run(["tar", "-x", "-f", packed, "-C", place, f"{self.package}/{DRIVER}", f"{self.package}/Makefile"])
        shutil.move(place / self.package / DRIVER, place / "xilinx_dma.c")
        shutil.move(place / self.package / "Makefile", place / "version")
        for folder in ("debs", "package", self.package):
            shutil.rmtree(place / folder)


def modules(cache: Cache, kernel: Kernel, other: Source | None) -> Path | None:
    """The model, the kernel's own xilinx_dma, and another kernel's; None for a kernel without its source."""
    driver = kernel.build / "source" / DRIVER
    if not driver.exists():
        return None
    drivers = {"xilinx_dma.c": driver} | ({"xilinx_dma_other.c": other.driver(cache)} if other else {})
    ours = REPOSITORY / "kmod"
    port = [ours / "plsim" / f"{name}.{kind}" for name in ("configport", "frames") for kind in "ch"]
    parts = [*port, ours / "uapi", ours / "include"]
    inputs = [kernel.release, str(kernel.build), MODEL, *drivers, *drivers.values(), *parts]

    def build(place: Path) -> None:
        shutil.copytree(MODEL, place, dirs_exist_ok=True)
        for name, file in drivers.items():
            shutil.copy2(file, place / "driver" / name)
        for part in parts:
            target = place / part.relative_to(ours)
            target.parent.mkdir(exist_ok=True)
            copy = shutil.copytree if part.is_dir() else shutil.copy2
            copy(part, target)
        run([*kernel.make(), f"-j{os.cpu_count() or 1}", f"M={place}", "modules"], log=place / "build.log")
        if other and not (place / "xilinx_dma_other.ko").exists():
            raise VmError(f"the driver of {other.package} was not built, see {place / 'build.log'}")

    return cache.entry(f"silicon-{kernel.release}", inputs, build)
