# SPDX-License-Identifier: Apache-2.0
"""The static overlay of other people's designs: windows, engines, clocks, decouplers and regions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.design.collect.foreign_dma import PS_CLOCKS, ClockInput, Engines, ForeignInterrupts
from cm.design.hdl.register_maps import identifier
from cm.design.platforms import Platform
from cm.design.render import Renderer
from cm.formats import hwh
from cm.schema.model import Config


@dataclass(frozen=True, slots=True)
class Bridge:
    """A DFX decoupler with registers of its own, as the kernel's driver xlnx,pr-decoupler needs it."""

    label: str
    base: int
    size: int
    clock: str


def overlay(design: hwh.Hwh, config: Config, platform: Platform, dma: Engines, lines: ForeignInterrupts) -> str:
    """The source of the overlay."""
    zynq = platform.name == "zynq7000"
    decouplers = {bridge.base: bridge for bridge in bridges(design)}
    context = {
        "name": config.name,
        "cells": 1 if zynq else 2,
        "intc": "intc" if zynq else "gic",
        "manager": "devcfg" if zynq else "zynqmp_pcap",
        "clocks": [ClockInput(c.name, _phandle(c.name), c.rate) for c in hwh.clocks(design)],
        "windows": list(_windows(design, lines)),
        "dma": dma,
        "channels": [(engine, channel) for engine in dma.found for channel in engine.channels],
        "bridges": list(decouplers.values()),
        "regions": {
            region.name: decouplers.get(region.decoupler.base_address) if region.decoupler else None
            for region in config.regions.values()
        },
    }
    return Renderer(Path("/"), Path("/"), "Written by cm build collect.").render("collected.dtso.j2", context)


def bridges(design: hwh.Hwh) -> Iterator[Bridge]:
    """Decouplers whose registers the processor reaches, and whose clock it gives."""
    sizes = {window.instance: window.size for window in hwh.windows(design)}
    for found in hwh.decouplers(design):
        if found.base is None or found.driver != found.instance or found.instance not in sizes:
            continue
        clock = _clock_of(design.modules[found.instance])
        if clock is not None:
            label = f"{identifier(found.instance)}_bridge"
            yield Bridge(label, found.base, sizes[found.instance], clock)


def _clock_of(module: hwh.ModuleInstance) -> str | None:
    port = module.ports.get("aclk") or module.ports.get("s_axi_aclk")
    ends = [end.port for end in port.connections] if port else []
    return next((PS_CLOCKS[name] for name in ends if name in PS_CLOCKS), None)


def _phandle(name: str) -> str:
    """The phandle of a clock by its name in the runtime schema, fclk0 or pl0."""
    return f"<{PS_CLOCKS[('FCLK_CLK' if name.startswith('fclk') else 'pl_clk') + name[-1]]}>"


def _windows(design: hwh.Hwh, lines: ForeignInterrupts) -> Iterator[dict[str, Any]]:
    """Windows for user space: all but those of DMA engines, each address once."""
    engines = {channel.instance for channel in hwh.dma_channels(design)}
    found = {window.base: window for window in hwh.windows(design) if window.instance not in engines}
    for window in found.values():
        if window.instance in design.modules:
            yield {
                "name": identifier(design.modules[window.instance].name).replace("_", "-"),
                "base": window.base,
                "size": window.size,
                "spi": lines.spis.get(window.instance),
            }
