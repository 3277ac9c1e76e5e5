# SPDX-License-Identifier: Apache-2.0
"""Loads by the kernel's fpga_manager."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from cm.manager.errors import LoadFailed, LoadUnsupported
from cm.manager.interfaces import Devices, Files, Image, KernelLoader
from cm.manager.loaders.job import Job, OnBytes, Start


class FpgaManagerLoader:
    """The kernel's fpga_manager, by firmware name (linux-xlnx). Blocks until the kernel is done."""

    def __init__(self, devices: Devices, files: Files) -> None:
        self._devices = devices
        self._files = files

    def check(self, job: Job) -> None:
        """Mainline kernels have no attribute to load by; the image has to lie where the kernel looks."""
        manager: KernelLoader = self._devices.fpga_manager(job.port)
        if not manager.can_load:
            raise LoadUnsupported(
                f"{job.image.path.name}: this kernel's fpga_manager cannot load through sysfs (linux-xlnx can); "
                "use loader: overlay with firmware-name, or loader: icap",
            )
        self._files.firmware_name(job.image)

    @contextmanager
    def prepared(self, job: Job, timeout: float) -> Iterator[Start]:  # noqa: ARG002 (the kernel has its own)
        """The image where the kernel looks for it."""
        manager: KernelLoader = self._devices.fpga_manager(job.port)
        name = self._files.firmware_name(job.image)
        yield lambda on_bytes: self._load(manager, name, job, on_bytes)

    def _load(self, manager: KernelLoader, name: str, job: Job, on_bytes: OnBytes) -> None:
        """The kernel reads the file itself: if it was replaced meanwhile, that may be what was loaded."""
        manager.load(name, partial=job.region is not None, encrypted=job.image.encrypted)
        _raise_not_operating(manager, job.image)
        self._files.check_firmware(name, job.image)
        on_bytes(job.image.length)

    def forget(self) -> None:
        """Nothing is kept."""


def _raise_not_operating(manager: KernelLoader, image: Image) -> None:
    state = manager.state
    if state != "operating":
        raise LoadFailed(f"{image.path.name}: fpga_manager {manager.name} says {state!r} after the load")
