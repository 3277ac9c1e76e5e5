# SPDX-License-Identifier: Apache-2.0
"""Loads by a device-tree overlay that names the firmware."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from cm.manager.errors import LoadFailed
from cm.manager.interfaces import Devices, Files, OverlayFolder
from cm.manager.loaders.job import Job, OnBytes, Start
from cm.manager.state.table import loading_overlay
from cm.schema.model import Region


class OverlayLoader:
    """An overlay with `firmware-name` on the region's fpga-region node: the kernel loads, then probes.

    The region's loading overlay is called ``cm-<region>``; the one before it is removed first, because
    a region refuses a second firmware overlay (Documentation/devicetree/bindings/fpga/fpga-region).
    """

    def __init__(self, devices: Devices, files: Files) -> None:
        self._devices = devices
        self._files = files

    def check(self, job: Job) -> None:
        """A full image cannot be loaded this way: the node of its region would go with it."""
        _region_of(job)
        self._files.firmware_name(job.image)

    @contextmanager
    def prepared(self, job: Job, timeout: float) -> Iterator[Start]:  # noqa: ARG002 (the kernel has its own)
        """The region's node without an overlay that an earlier run left."""
        firmware = self._files.firmware_name(job.image)
        overlays = self._devices.overlays()
        name = loading_overlay(_region_of(job).name)
        if name in overlays.list():
            overlays.remove(name)
        yield lambda on_bytes: self._load(overlays, name, firmware, job, on_bytes)

    def _load(self, overlays: OverlayFolder, name: str, firmware: str, job: Job, on_bytes: OnBytes) -> None:
        """The kernel reads our copy itself: if another process has written to it, that may be what was loaded."""
        overlays.apply(name, job.overlay)
        self._files.check_firmware(firmware, job.image)
        on_bytes(job.image.length)

    def forget(self) -> None:
        """Nothing is kept."""


def _region_of(job: Job) -> Region:
    if job.region is None:
        raise LoadFailed(f"{job.image.path.name}: a whole image is loaded by fpga_manager or icap, not by overlay")
    return job.region
