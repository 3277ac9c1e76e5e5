# SPDX-License-Identifier: Apache-2.0
"""How an image reaches the device: a small interface and its implementations, one per `LoaderKind`."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator

from cm.errors import CmError
from cm.manager.loaders.choice import resolved
from cm.manager.loaders.fpga_manager import FpgaManagerLoader
from cm.manager.loaders.icap import IcapLoader
from cm.manager.loaders.job import Job, Loader, Start
from cm.manager.loaders.overlay import OverlayLoader
from cm.manager.ports import Clock, Devices, Files
from cm.schema.model import Config, LoaderKind

__all__ = ["Job", "Loader", "Loaders", "Start"]


class Loaders:
    """One loader of each kind."""

    def __init__(self, devices: Devices, files: Files, clock: Clock, prefetch_bytes: int) -> None:
        self._files, self._devices = files, devices
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

    def prefetch_modules(self, config: Config | None, go_on: Callable[[], bool]) -> None:
        """The same for the images of a configuration's modules. What is wrong with one shows when it is used."""
        config = resolved(config, (), self._devices)[0] if config else None
        jobs = list(self._jobs(config, go_on)) if config else []
        if config is not None and go_on():
            with contextlib.suppress(CmError, OSError):
                self.prefetch(jobs, go_on)

    def _jobs(self, config: Config, go_on: Callable[[], bool]) -> Iterator[Job]:
        for module in config.modules.values():
            if not go_on():
                return
            with contextlib.suppress(CmError, OSError):
                yield Job(config, self._files.image(config, module), config.regions[module.region], module)

    def forget(self) -> None:
        """The board was lost."""
        for loader in self._all.values():
            loader.forget()
