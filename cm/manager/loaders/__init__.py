# SPDX-License-Identifier: Apache-2.0
"""How an image reaches the device: which port, and a loader for each kind of one."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType

from cm.errors import CmError
from cm.manager.errors import NoPort
from cm.manager.interfaces import Devices, Files, TimeSource
from cm.manager.loaders.fpga_manager import FpgaManagerLoader
from cm.manager.loaders.icap import IcapLoader
from cm.manager.loaders.job import Job, Loader, Start
from cm.manager.loaders.overlay import OverlayLoader
from cm.manager.state.choice import Choice
from cm.schema.model import Config, LoaderKind, Region

__all__ = ["Job", "Loader", "Loaders", "Start"]


class Loaders:
    """One loader of each kind."""

    def __init__(self, devices: Devices, files: Files, time: TimeSource, prefetch_bytes: int) -> None:
        self._files, self._devices = files, devices
        self._icap = IcapLoader(devices, files, time, prefetch_bytes)
        self._all: dict[LoaderKind, Loader] = {
            LoaderKind.ICAP: self._icap,
            LoaderKind.FPGA_MANAGER: FpgaManagerLoader(devices, files),
            LoaderKind.OVERLAY: OverlayLoader(devices, files),
        }

    def kind(self, kind: LoaderKind) -> Loader:
        """The loader of a kind."""
        return self._all[kind]

    def instead(self, job: Job, schema: Config, refused: Exception) -> tuple[Loader, Choice]:
        """The loader after the ICAP has refused a load, if the schema leaves the port open. Else raises `refused`."""
        region = schema.regions.get(job.region.name) if job.region else None
        chosen = job.region.loader if job.region else None
        if region is None or region.loader is not LoaderKind.AUTO or chosen is not LoaderKind.ICAP:
            raise refused
        if _against_fpga_manager(job.port, self._devices):
            raise refused
        other = self._all[LoaderKind.FPGA_MANAGER]
        other.check(job)
        return other, Choice(LoaderKind.FPGA_MANAGER, f"icap: {refused}")

    def prefetch(self, jobs: Iterable[Job], go_on: Callable[[], bool] = lambda: True) -> None:
        """Keep only these images ready, if their loader can; asks `go_on` before each."""
        self._icap.prefetch([j for j in jobs if j.region and j.region.loader is LoaderKind.ICAP], go_on)

    def prefetch_modules(self, config: Config | None, go_on: Callable[[], bool]) -> None:
        """The same for the images of a configuration's modules. Errors in one are reported when it is used."""
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
                region = config.regions[module.region]
                yield Job(config, self._files.image(config, module), region, module, port=region.loader_name)

    def forget(self) -> None:
        """The board was lost."""
        for loader in self._all.values():
            loader.forget()


def resolved(config: Config, wanted: Collection[str], devices: Devices) -> tuple[Config, Mapping[str, Choice]]:
    """The configuration with a port for each region of `loader: auto`, and the choices by region.

    Raises NoPort if a region in `wanted` cannot be loaded; for the others this is reported when they are needed.
    """
    open_ = [region for region in config.regions.values() if region.loader is LoaderKind.AUTO]
    choices = {region.name: _choose(region, region.name in wanted, devices) for region in open_}
    if not choices:
        return config, MappingProxyType({})
    regions = {
        name: replace(region, loader=choices[name].kind) if name in choices else region
        for name, region in config.regions.items()
    }
    return replace(config, regions=MappingProxyType(regions)), MappingProxyType(choices)


def _choose(region: Region, wanted: bool, devices: Devices) -> Choice:
    """The ICAP is the faster one, and loads by it need no file where the kernel looks."""
    reasons: list[str] = []
    for kind, refusal in _ports(region, devices):
        if not refusal:
            return Choice(kind, "; ".join(reasons))
        reasons.append(f"{kind.value}: {refusal}")
    if wanted:
        raise NoPort(
            f"region {region.name} (loader: auto) cannot be loaded. {'; '.join(reasons)}. Mainline kernels load by "
            "overlays with firmware-name: loader: overlay"
        )
    return Choice(LoaderKind.ICAP, "; ".join(reasons))


def _ports(region: Region, devices: Devices) -> Iterator[tuple[LoaderKind, str]]:
    """The ports in their order, each with what prevents its use."""
    yield LoaderKind.ICAP, _against_icap(region.loader_name, devices)
    yield LoaderKind.FPGA_MANAGER, _against_fpga_manager(region.loader_name, devices)


def _against_icap(name: str | None, devices: Devices) -> str:
    if name is not None and name.startswith("fpga"):
        return f"the schema names {name}"
    try:
        info = devices.icap(name).info
    except (CmError, OSError) as error:
        return str(error)
    return "the platform's firmware does not let it be selected" if info.denied else ""


def _against_fpga_manager(name: str | None, devices: Devices) -> str:
    try:
        manager = devices.fpga_manager(name if name is not None and name.startswith("fpga") else None)
        return "" if manager.can_load else "this kernel's fpga_manager has no firmware attribute (linux-xlnx has)"
    except (CmError, OSError) as error:
        return str(error)
