# SPDX-License-Identifier: Apache-2.0
"""Interrupts of other people's designs, from their .hwh, as far as an overlay can give them to UIO devices.

A UIO device has one interrupt, so of an instance with several lines the first usable one is taken; the others become
notes. Lines behind an axi_intc are not usable: the kernel's driver for it (irq-xilinx-intc.c) is bound while the
kernel boots, not by an overlay.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from cm.design.hdl.register_maps import identifier
from cm.design.platforms import Platform
from cm.formats import hwh
from cm.schema.model import Interrupt


@dataclass(slots=True)
class ForeignInterrupts:
    """`lines`: name in the runtime schema → interrupt; `spis`: instance → GIC SPI; a note for each line left out."""

    lines: dict[str, Interrupt] = field(default_factory=dict)
    spis: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def interrupts(design: hwh.Hwh, platform: Platform) -> ForeignInterrupts:
    """Interrupts of instances with a register window; those of DMA engines belong to their driver."""
    bases = {window.instance: window.base for window in reversed(hwh.windows(design))}
    engines = {channel.instance for channel in hwh.dma_channels(design)}
    found = ForeignInterrupts()
    for line in hwh.interrupts(design):
        if line.instance not in bases or line.instance in engines:
            continue
        spi = platform.spi_at(line.pin, line.index) if line.controller is None else None
        if spi is None:
            goes = line.controller or line.pin
            found.notes.append(f"interrupt {line.port} of {line.instance} goes to {goes}: {_OWN_TREE}")
        elif line.instance in found.spis:
            found.notes.append(f"interrupt {line.port} of {line.instance} is not its first: {_ONE}")
        else:
            name = f"{identifier(design.modules[line.instance].name)}_{identifier(line.port)}"
            found.lines[name] = Interrupt(name, bases[line.instance])
            found.spis[line.instance] = spi
    return found


_OWN_TREE = "no overlay can give that to a UIO device; it needs a node in the board's own tree"
_ONE = "a UIO device has one, so this one is left out (join them in the PL, with a status register)"
