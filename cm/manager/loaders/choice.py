# SPDX-License-Identifier: Apache-2.0
"""Which port loads a region whose schema says `loader: auto`: asked before anything is touched."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType

from cm.errors import CmError
from cm.manager.errors import NoPort
from cm.manager.ports import Devices
from cm.manager.state.choice import Choice
from cm.schema.model import Config, LoaderKind, Region


def resolved(config: Config, wanted: Collection[str], devices: Devices) -> tuple[Config, Mapping[str, Choice]]:
    """The configuration with a port for each region of `loader: auto`, and what was chosen, by region.

    Raises NoPort where none of those `wanted` (regions) can be loaded; of the others, that shows when they are wanted.
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
    """The ports in their order, each with what stands against it."""
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
