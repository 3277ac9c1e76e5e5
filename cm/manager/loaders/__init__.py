# SPDX-License-Identifier: Apache-2.0
"""How an image reaches the device: a small interface and its implementations, one per `LoaderKind`."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cm.manager.loaders.fpga_manager import FpgaManagerLoader
from cm.manager.loaders.icap import IcapLoader
from cm.manager.loaders.job import Job, Loader, Start
from cm.manager.loaders.overlay import OverlayLoader, loading_overlay
from cm.manager.ports import Clock, Devices, Files
from cm.schema.model import LoaderKind

__all__ = ["Job", "Loader", "Loaders", "Start", "loading_overlay"]


class Loaders:
    """One loader of each kind."""

    def __init__(self, devices: Devices, files: Files, clock: Clock, prefetch_bytes: int) -> None:
        self._icap = IcapLoader(devices, files, clock, prefetch_bytes)
        self._all: dict[LoaderKind, Loader] = {
            LoaderKind.ICAP: self._icap,
            LoaderKind.FPGA_MANAGER: FpgaManagerLoader(devices, files),
            LoaderKind.OVERLAY: OverlayLoader(devices, files),
        }

    def kind(self, kind: LoaderKind) -> Loader:
        """The loader of a kind."""
        return self._all[kind]

    def prefetch(self, jobs: Iterable[Job], go_on: Callable[[], bool] = lambda: True) -> None:
        """Keep these images ready where their loader can, and no others; asks `go_on` before each."""
        self._icap.prefetch([j for j in jobs if j.region and j.region.loader is LoaderKind.ICAP], go_on)

    def forget(self) -> None:
        """The board was lost."""
        for loader in self._all.values():
            loader.forget()
