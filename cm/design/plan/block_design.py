# SPDX-License-Identifier: Apache-2.0
"""The variables of the block-design template: settings of the processing system, ports, addresses, interrupts.

Which of its ports connect the design to memory is chosen here.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.hdl.model import Interface
from cm.design.plan.addresses import Window
from cm.design.plan.dma_cells import DmaCell, dma_cell
from cm.design.plan.system import System, used_clocks
from cm.frozen import dataclass, replace

MAX_SLAVES = 16  # at one SmartConnect (PG247)
HPM_WIDTH = 128  # bits of UltraScale+'s register ports
WIDTH = {False: 64, True: 128}  # bits of a memory port; the key: UltraScale+ or not


@dataclass(frozen=True, slots=True)
class MemoryPort:
    """A slave port of the processing system; `number`: that of its parameters and of its AFI.

    `prefix`: how the names of its pins begin, needed for coherent ports only.
    """

    slave: str
    clock: str
    number: int
    coherent: bool = False

    @property
    def prefix(self) -> str:
        """The beginning of its signals' names: ``saxigp0``."""
        return f"saxigp{self.number}"


def memory_ports(system: System) -> list[tuple[MemoryPort, int]]:
    """Return ports with their number of masters: first those of regions and their engines, last that of the ICAP.

    If a port is left, the ICAP's engine has the last one to itself, so that loads do not wait for streams. On
    Zynq-7000 that is HP3, which shares its path to the memory controller with HP2 only (UG585, chapter 5).
    """
    platform, coherent = system.platform, system.project.static.coherent
    slaves = platform.coherent_slaves if coherent else platform.memory_slaves
    clocks = platform.coherent_clocks if coherent else platform.memory_clocks
    # UltraScale+: S_AXI_GP0 and GP1 are HPC0 and HPC1, GP2 to GP5 are HP0 to HP3; AFIs have the same numbers (UG1085)
    first = 2 if platform.ultrascale and not coherent else 0
    masters = sum(engine.masters for engine in system.engines) + sum(len(region.memory) for region in system.regions)
    own = system.engines[0].masters if system.icap else 0
    apart = own if 0 < -(-(masters - own) // MAX_SLAVES) < len(slaves) else 0
    counts = [min(MAX_SLAVES, masters - apart - done) for done in range(0, masters - apart, MAX_SLAVES)]
    if len(counts) > len(slaves):
        kind = "coherent ports" if coherent else "ports"
        message = f"{masters} masters to memory are more than the processing system's {kind} can take"
        raise BuildError(f"{message}: let streams share an engine (engine: NAME under the region's interfaces)")
    used = [*enumerate(counts), *([(len(slaves) - 1, apart)] if apart else [])]
    return [(MemoryPort(slaves[i], clocks[i], first + i, coherent), count) for i, count in used]


@dataclass(frozen=True, slots=True)
class ClockPin:
    """A clock of the processing system that is in use."""

    name: str
    pin: str
    rate: int
    buses: tuple[str, ...] = ()  # interface ports of the block design that run on it


@dataclass(frozen=True, slots=True)
class AxiPort:
    """An AXI port of the block design; `mode` as seen from outside it."""

    name: str
    mode: str
    doc: str
    clock: str
    settings: tuple[tuple[str, object], ...]


@dataclass(frozen=True, slots=True)
class MemoryInterconnect:
    """A high-performance port of the processing system and the masters that share it."""

    cell: str
    port: MemoryPort
    sources: tuple[str, ...]


UNUSED_LINE = "[get_bd_pins no_interrupt/dout]"


@dataclass(frozen=True, slots=True)
class InterruptBundle:
    """A bundle of interrupt lines to a pin of the processing system."""

    cell: str
    pin: str
    sources: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Branch:
    """An interconnect behind a port of the control interconnect."""

    cell: str
    masters: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Segment:
    """An address range of the control master."""

    window: Window
    target: str


def context(system: System) -> dict[str, object]:
    """Variables of ``block_design.tcl.j2``."""
    clocks = _clocks(system)
    pins = {clock.name: clock.pin for clock in clocks}
    dmas = [dma_cell(system, engine, pins[engine.clock]) for engine in system.engines]
    ports = list(_axi_ports(system))
    memories = list(_memories(system, dmas))
    masters = [f"[get_bd_intf_ports {port.name}]" for port in ports if port.mode == "Master"]
    masters += [f"[get_bd_intf_pins {dma.cell}/S_AXI_LITE]" for dma in dmas]
    control, branches = _control(masters)
    return {
        "platform": system.platform,
        "board": system.project.board,
        "clocks": [_with_buses(clock, dmas, ports) for clock in clocks],
        "ps_settings": list(_ps_settings(system, clocks, memories)),
        "dmas": dmas,
        "axi_ports": ports,
        "masters": control,
        "branches": branches,
        "memories": memories,
        "interrupts": list(_interrupts(system)),
        "joined": list(_joined(system)),
        "segments": list(_segments(system)),
        "user_files": list[Path](system.project.static.block_design),
    }


def _clocks(system: System) -> list[ClockPin]:
    order = list(system.project.clocks)
    used = [name for name in order if name in used_clocks(system)]
    return [ClockPin(n, system.platform.clock_pins[order.index(n)], system.project.clocks[n].rate) for n in used]


def _with_buses(clock: ClockPin, dmas: list[DmaCell], ports: list[AxiPort]) -> ClockPin:
    buses = [port.name for dma in dmas if dma.clock == clock.name for port in dma.ports]
    buses += [port.name for port in ports if port.clock == clock.name]
    return replace(clock, buses=tuple(buses))


def _ps_settings(
    system: System, clocks: list[ClockPin], memories: list[MemoryInterconnect]
) -> Iterator[tuple[str, object]]:
    pins = system.platform.clock_pins
    if system.platform.name == "zynq7000":
        yield "PCW_USE_M_AXI_GP0", 1
        for memory in memories:
            yield f"PCW_USE_S_AXI_HP{memory.port.number}", 1
            yield f"PCW_S_AXI_HP{memory.port.number}_DATA_WIDTH", WIDTH[False]
        yield "PCW_USE_FABRIC_INTERRUPT", 1
        yield "PCW_IRQ_F2P_INTR", 1
        for clock in clocks:
            index = pins.index(clock.pin)
            yield f"PCW_EN_CLK{index}_PORT", 1
            yield f"PCW_FPGA{index}_PERIPHERAL_FREQMHZ", _megahertz(clock.rate)
        return
    yield "PSU__USE__M_AXI_GP0", 1
    yield "PSU__USE__M_AXI_GP1", 0
    yield "PSU__USE__M_AXI_GP2", 0
    yield "PSU__MAXIGP0__DATA_WIDTH", HPM_WIDTH
    for memory in memories:
        yield f"PSU__USE__S_AXI_GP{memory.port.number}", 1
        yield f"PSU__SAXIGP{memory.port.number}__DATA_WIDTH", WIDTH[True]
    yield "PSU__USE__IRQ0", 1
    yield "PSU__USE__IRQ1", int(_wires(system) > 8)
    for clock in clocks:
        index = pins.index(clock.pin)
        yield f"PSU__FPGA_PL{index}_ENABLE", 1
        yield f"PSU__CRL_APB__PL{index}_REF_CTRL__FREQMHZ", _megahertz(clock.rate)


def _megahertz(rate: int) -> str:
    return f"{rate / 1e6:.6f}".rstrip("0").rstrip(".")


def _axi_ports(system: System) -> Iterator[AxiPort]:
    for domain in system.domains:
        settings = (("PROTOCOL", "AXI4LITE"), ("DATA_WIDTH", 32), ("ADDR_WIDTH", 32))
        doc = f"register windows on {domain.clock}"
        yield AxiPort(f"m_axi_{domain.clock}", "Master", doc, domain.clock, settings)
    for region in system.regions:
        full = [("m_axi", "Master", bus.interface) for bus in region.registers if bus.full]
        for prefix, mode, interface in (*full, *(("s_axi", "Slave", interface) for interface in region.memory)):
            name, doc = f"{prefix}_{region.name}_{interface.name}", f"{region.name}.{interface.name}"
            yield AxiPort(name, mode, doc, region.clock_of(interface), _settings(interface))


def _settings(interface: Interface) -> tuple[tuple[str, object], ...]:
    lite = interface.protocol == "axi4lite"
    settings: list[tuple[str, object]] = [
        ("PROTOCOL", "AXI4LITE" if lite else "AXI4"),
        ("DATA_WIDTH", interface.data_width or 32),
        ("ADDR_WIDTH", interface.addr_width or 32),
    ]
    if not lite:
        settings += [("ID_WIDTH", interface.id_width or 0), ("NUM_READ_OUTSTANDING", 8), ("NUM_WRITE_OUTSTANDING", 8)]
        for signal in ("LOCK", "CACHE", "QOS", "REGION"):
            there = any(f"{channel}{signal}" in interface.ports for channel in ("AW", "AR"))
            # the top drives AxCACHE if the module does not have it
            settings.append((f"HAS_{signal}", int(there or signal == "CACHE")))
    if not (interface.reads and interface.writes):
        settings.append(("READ_WRITE_MODE", "READ_ONLY" if interface.reads else "WRITE_ONLY"))
    return tuple(settings)


def _control(masters: list[str]) -> tuple[list[str], list[Branch]]:
    """Assign the control interconnect's ports; beyond 16, further interconnects are put behind its last ones."""
    if len(masters) <= MAX_SLAVES:
        return masters, []
    count = -(-(len(masters) - MAX_SLAVES) // (MAX_SLAVES - 1))
    if count > MAX_SLAVES:
        raise BuildError(f"{len(masters)} register ports are more than two levels of interconnects have")
    direct, rest = masters[: MAX_SLAVES - count], masters[MAX_SLAVES - count :]
    cells = [f"control_interconnect_{number}" for number in range(1, count + 1)]
    shares = [tuple(rest[i * MAX_SLAVES : (i + 1) * MAX_SLAVES]) for i in range(count)]
    branches = [Branch(cell, share) for cell, share in zip(cells, shares, strict=True)]
    return direct + [f"[get_bd_intf_pins {cell}/S00_AXI]" for cell in cells], branches


def _memories(system: System, dmas: list[DmaCell]) -> Iterator[MemoryInterconnect]:
    """Distribute masters to memory over the processing system's ports, with one interconnect per port."""
    found = {dma.name: [f"[get_bd_intf_pins {dma.cell}/{pin}]" for pin in dma.memory_pins] for dma in dmas}
    last = found.pop(system.icap.name) if system.icap else []
    sources = [source for listed in found.values() for source in listed]
    for region in system.regions:
        sources += [f"[get_bd_intf_ports s_axi_{region.name}_{interface.name}]" for interface in region.memory]
    sources += last
    for index, (port, count) in enumerate(memory_ports(system)):
        share, sources = sources[:count], sources[count:]
        yield MemoryInterconnect(f"memory_interconnect_{index}", port, tuple(share))


def _interrupts(system: System) -> Iterator[InterruptBundle]:
    """Line 0 is the control registers'; the others are channels', each one's or several joined by the static part.

    A wire that the board's image has given away stays at 0.
    """
    crowded, platform = system.crowded, system.platform
    cells = {channel.name: f"dma_{engine.name}" for engine in system.engines for channel in engine.channels}
    by_spi = {platform.spi(0): "[get_bd_ports irq]"}
    for dma in system.dmas:
        own = f"[get_bd_pins {cells[dma.name]}/{dma.interrupt_pin}]"
        by_spi[platform.spi(dma.line)] = f"[get_bd_ports irq_line_{dma.line}]" if dma.line in crowded else own
    merged: dict[str, list[str]] = {}
    for pin, spi in platform.irq_wires[: _wires(system)]:
        merged.setdefault(pin, []).append(by_spi.get(spi, UNUSED_LINE))
    for index, (pin, share) in enumerate(merged.items()):
        yield InterruptBundle(f"interrupt_lines_{index}", pin, tuple(share))


def _wires(system: System) -> int:
    """How many wires of interrupts go to the processing system: up to the last one in use."""
    last = system.platform.spi(max([dma.line for dma in system.dmas], default=0))
    return 1 + [spi for _, spi in system.platform.irq_wires].index(last)


def _joined(system: System) -> Iterator[tuple[str, str, int]]:
    """Channels whose interrupt passes through the static part: port of the block design, pin, line."""
    crowded = system.crowded
    for engine in system.engines:
        for channel in engine.channels:
            if channel.line in crowded:
                yield f"irq_{channel.name}", f"dma_{engine.name}/{channel.interrupt_pin}", channel.line


def _segments(system: System) -> Iterator[Segment]:
    for domain in system.domains:
        target = f"[get_bd_addr_segs m_axi_{domain.clock}/Reg]"
        yield Segment(domain.aperture, target)
    for region in system.regions:
        for bus in region.registers:
            if bus.full:
                yield Segment(bus.window, f"[get_bd_addr_segs m_axi_{region.name}_{bus.interface.name}/Reg]")
    for engine in system.engines:
        yield Segment(engine.window, f"[get_bd_addr_segs dma_{engine.name}/S_AXI_LITE/Reg]")
