# SPDX-License-Identifier: Apache-2.0
"""DMA engines of other people's designs, from their .hwh, as the device-tree overlay needs them.

Properties are those of the kernel's binding dma/xilinx/xilinx_dma.txt, each from the IP parameter that
Xilinx/device-tree-xlnx ac65e01 (axi_dma.tcl and axi_vdma.tcl) uses. An MCDMA has one clock for everything but its
registers; it is listed under the three names that the driver looks for.

Interrupts of other people's designs, from their .hwh, as far as an overlay can give them to UIO devices.

A UIO device has one interrupt, so of an instance with several lines the first usable one is taken; the others become
notes. Lines behind an axi_intc, and those of an axi_dma or axi_vdma that are connected to nothing, need ``cm_intc``:
the kernel's driver of an axi_intc (irq-xilinx-intc.c) finds it while the kernel boots, never in an overlay.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from cm.design.generate.dma_nodes import Channel, ClockInput, Engine, Streams, Tree, pl_clock, streams_of
from cm.design.generate.interrupt_nodes import AxiIntc, Line, PolledIntc
from cm.design.platforms import Platform
from cm.formats import hwh
from cm.formats.registers import identifier
from cm.schema.model import Interrupt

_CLOCK_PINS = {
    "axi_dma": ("s_axi_lite_aclk", "m_axi_sg_aclk", "m_axi_mm2s_aclk", "m_axi_s2mm_aclk"),
    "axi_vdma": ("s_axi_lite_aclk", "m_axi_mm2s_aclk", "m_axi_s2mm_aclk", "m_axis_mm2s_aclk", "s_axis_s2mm_aclk"),
    "axi_mcdma": ("s_axi_lite_aclk", "s_axi_aclk"),
}
_NAMES = {("axi_mcdma", "s_axi_aclk"): ("m_axi_sg_aclk", "m_axi_mm2s_aclk", "m_axi_s2mm_aclk")}
_S2MM_FIRST = {"axi_mcdma": 16}  # the driver's number of the first S2MM channel; 1 of the others
PS_CLOCKS = {f"{pin}{i}": pl_clock(pin == "FCLK_CLK", i) for pin in ("FCLK_CLK", "pl_clk") for i in range(4)}
_LENGTH_BITS = 14  # the default of an axi_dma (PG021)
_NAME_LENGTH = 31  # of a node in /dev/cm_dma
_STATUS = {"mm2s": 0x04, "s2mm": 0x34}  # DMASR (PG021, PG020)
_POLLED = ("axi_dma", "axi_vdma")


@dataclass(slots=True)
class Engines:
    """The engines for the overlay, what finds interrupts that are connected to nothing, and notes on channels."""

    found: list[Engine] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    polled: PolledIntc = field(default_factory=PolledIntc)

    @property
    def fixed_clocks(self) -> list[ClockInput]:
        """Clocks that the PL makes itself, each once."""
        clocks = {clock.source: clock for engine in self.found for clock in engine.clocks if clock.rate}
        return [clocks[name] for name in sorted(clocks)]

    @property
    def streams(self) -> list[Streams]:
        """Their channels: one length for all, as far as their registers go."""
        return streams_of([(engine, channel) for engine in self.found for channel in engine.channels])


class Lines:
    """Where interrupts of the design go, in the words of its device tree."""

    def __init__(self, design: hwh.Hwh, platform: Platform) -> None:
        self._platform, self._tree = platform, Tree(platform)
        windows = {window.instance: window for window in reversed(hwh.windows(design))}
        self.controllers: dict[str, AxiIntc] = {}
        for output in hwh.interrupt_controllers(design):
            window, line = windows.get(output.instance), self._at_processor(output)
            if window is not None and line is not None:
                module = design.modules[output.instance]
                edges, inputs = _integer(module, "C_KIND_OF_INTR", 0), _integer(module, "C_NUM_INTR_INPUTS", 1)
                label, place = identifier(output.instance), (window.base, window.size)
                self.controllers[output.instance] = AxiIntc(label, *place, inputs, edges & ((1 << inputs) - 1), line)

    def of(self, line: hwh.InterruptLine | None) -> Line | None:
        """An interrupt; None where it goes nowhere, or where a device tree has no words for it."""
        if line is None or line.controller is None:
            return self._at_processor(line) if line else None
        controller = self.controllers.get(line.controller)
        return controller.line_of(line.index) if controller and line.index < controller.inputs else None

    def _at_processor(self, line: hwh.InterruptLine) -> Line | None:
        spi = self._platform.spi_at(line.pin, line.index)
        return None if spi is None else self._tree.spi(spi, line.edge)


def stream_names(channels: Iterable[hwh.DmaChannel], design: hwh.Hwh) -> dict[hwh.DmaChannel, str]:
    """Channel → stream: the engine's name, with direction and number if it has several channels; each unique."""
    listed = list(channels)
    found: dict[hwh.DmaChannel, str] = {}
    for channel in listed:
        mine = [other for other in listed if other.instance == channel.instance]
        several = sum(other.direction == channel.direction for other in mine) > 1
        end = (f"_{channel.direction}" if len(mine) > 1 else "") + (f"_{channel.number}" if several else "")
        name = identifier(design.modules[channel.instance].name)[: _NAME_LENGTH - len(end)] + end
        if name in found.values():  # of the same name in another hierarchy
            name = identifier(channel.instance)[: _NAME_LENGTH - len(end)] + end
        number = 2
        while name in found.values():
            name, number = f"{name[: _NAME_LENGTH - 3]}_{number}", number + 1
        found[channel] = name
    return found


def engines(design: hwh.Hwh, platform: Platform, names: Mapping[hwh.DmaChannel, str] | None = None) -> Engines:
    """Every engine whose address and interrupts can be described to the kernel; `names` of their streams."""
    listed = hwh.dma_channels(design)
    names = names or stream_names(listed, design)
    wires = {(line.instance, line.port): line for line in hwh.interrupts(design)}
    windows = {window.instance: window for window in reversed(hwh.windows(design))}
    unwired = [one for one in listed if one.kind in _POLLED and one.instance in windows and not _wire(one, wires)]
    polled = PolledIntc(tuple(_status(channel, windows) for channel in unwired))
    result, at = Engines(polled=polled), Lines(design, platform)
    for instance in dict.fromkeys(channel.instance for channel in listed):
        mine = [channel for channel in listed if channel.instance == instance]
        module, window = design.modules[instance], windows.get(instance)
        if module.type not in _CLOCK_PINS or window is None:
            why = (
                "has no address"
                if module.type in _CLOCK_PINS
                else f"is an {module.type}, whose channels are not described"
            )
            result.notes.append(f"{instance} {why}: its streams need a DMA node in the board's own tree")
            continue
        lines = {channel: at.of(_wire(channel, wires)) for channel in mine}
        lines |= {one: polled.line_of(_status(one, windows)) for one in unwired if one.instance == instance}
        for channel in (channel for channel in mine if lines[channel] is None):
            wire = _wire(channel, wires)
            why = f"goes to {wire.controller or wire.pin}" if wire else "goes nowhere"
            result.notes.append(
                f"stream {names[channel]}: the interrupt of {instance} {why}, and the kernel's DMA driver needs one of "
                "the processor's shared interrupts: it needs a DMA node in the board's own tree"
            )
        channels = tuple(_channels(lines, names, module))
        if module.type == "axi_mcdma":
            channels, alone = _whole(channels, mine)
            if alone:
                left = ", ".join(channel.stream for channel in alone)
                result.notes.append(f"{instance}: without all interrupts of a direction, {left} is left out too")
        if channels:
            result.found.append(_engine(module, window, channels, design))
    return result


def _whole(there: tuple[Channel, ...], mine: list[hwh.DmaChannel]) -> tuple[tuple[Channel, ...], tuple[Channel, ...]]:
    """Separate the directions in which every channel has an interrupt: the driver counts channels by interrupts."""
    wanted = Counter(channel.direction for channel in mine)
    whole = {way for way, count in Counter(c.direction for c in there).items() if count == wanted[way]}
    return tuple(c for c in there if c.direction in whole), tuple(c for c in there if c.direction not in whole)


def _wire(channel: hwh.DmaChannel, wires: Mapping[tuple[str, str], hwh.InterruptLine]) -> hwh.InterruptLine | None:
    return wires.get((channel.instance, channel.interrupt_port))


def _status(channel: hwh.DmaChannel, windows: Mapping[str, hwh.MemoryRange]) -> int:
    return windows[channel.instance].base + _STATUS[channel.direction]


def _channels(
    lines: Mapping[hwh.DmaChannel, Line | None], names: Mapping[hwh.DmaChannel, str], module: hwh.ModuleInstance
) -> Iterator[Channel]:
    for channel, line in lines.items():
        if line is not None:
            realigns = module.parameters.get(f"C_INCLUDE_{channel.direction.upper()}_DRE") == "1"
            first = _S2MM_FIRST.get(channel.kind, 1) if channel.direction == "s2mm" else 0
            number = first + channel.number
            yield Channel(names[channel], channel.direction, line, channel.width or 32, realigns, number)


def _engine(
    module: hwh.ModuleInstance, window: hwh.MemoryRange, channels: tuple[Channel, ...], design: hwh.Hwh
) -> Engine:
    return Engine(
        label=identifier(module.instance),
        kind=module.type,
        base=window.base,
        size=window.size,
        address_bits=_integer(module, "C_ADDR_WIDTH", 32),
        length_bits=min(_integer(module, "C_SG_LENGTH_WIDTH", _LENGTH_BITS), 26),
        frames=_integer(module, "C_NUM_FSTORES", 3),
        flushes=(module.parameters.get("C_FLUSH_ON_FSYNC") or module.parameters.get("c_flush_on_fsync", "1")) != "0",
        clocks=tuple(_clocks(module, design)),
        channels=channels,
    )


def _integer(module: hwh.ModuleInstance, name: str, default: int) -> int:
    """Read a parameter of the core, or the one of its customisation (``c_addr_width``) if the file has only that."""
    text = module.parameters.get(name) or module.parameters.get(name.lower(), "")
    hexadecimal = re.fullmatch(r"0[xX]([0-9A-Fa-f]+)", text)
    value = int(hexadecimal[1], 16) if hexadecimal else int(text) if text.isdecimal() else 0
    return value or default


def _clocks(module: hwh.ModuleInstance, design: hwh.Hwh) -> Iterator[ClockInput]:
    """Connected clock inputs; the first is the one that the driver insists on."""
    for pin in _CLOCK_PINS[module.type]:
        port = module.ports.get(pin)
        drivers = [end for end in port.connections if _drives(design, end)] if port else []
        if port is None or not (drivers or port.rate):
            continue
        known = next((PS_CLOCKS[end.port] for end in drivers if end.port in PS_CLOCKS), None)
        for name in _NAMES.get((module.type, pin), (pin,)):
            if known is not None:
                yield ClockInput(name, known)
            elif port.rate:
                yield ClockInput(name, f"&cm_clock_{port.rate}", port.rate)


def _drives(design: hwh.Hwh, end: hwh.ConnectedPort) -> bool:
    module = design.modules.get(end.instance)
    return module is not None and end.port in module.ports and module.ports[end.port].direction == "O"


@dataclass(slots=True)
class ForeignInterrupts:
    """`lines`: name in the runtime schema → interrupt; `nodes`: instance → where it goes; `controllers` on the way; a
    note for each interrupt left out.
    """

    lines: dict[str, Interrupt] = field(default_factory=dict)
    nodes: dict[str, Line] = field(default_factory=dict)
    controllers: dict[str, AxiIntc] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def interrupts(design: hwh.Hwh, platform: Platform) -> ForeignInterrupts:
    """Interrupts of instances with a register window; those of DMA engines belong to their driver."""
    bases = {window.instance: window.base for window in reversed(hwh.windows(design))}
    engines = {channel.instance for channel in hwh.dma_channels(design)}
    at = Lines(design, platform)
    found = ForeignInterrupts(controllers=at.controllers)
    for line in hwh.interrupts(design):
        if line.instance not in bases or line.instance in engines:
            continue
        goes = at.of(line)
        if goes is None:
            where = line.controller or line.pin
            found.notes.append(f"interrupt {line.port} of {line.instance} goes to {where}: {_OWN_TREE}")
        elif line.instance in found.nodes:
            found.notes.append(f"interrupt {line.port} of {line.instance} is not its first: {_ONE}")
        else:
            name = f"{identifier(design.modules[line.instance].name)}_{identifier(line.port)}"
            found.lines[name] = Interrupt(name, bases[line.instance])
            found.nodes[line.instance] = goes
    return found


_OWN_TREE = "no overlay can give that to a UIO device; it needs a node in the board's own tree"
_ONE = "a UIO device has one, so this one is left out (join them in the PL, with a status register)"
