# SPDX-License-Identifier: Apache-2.0
"""Questions to a block design: windows, interrupts, DMA channels, decouplers, clocks.

Registers of common IPs whose instances do not always describe them in the `.hwh` (PG144, PG079).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from cm.formats.hwh.reader import DECIMAL, BusInterface, ConnectedPort, Hwh, MemoryRange, ModuleInstance
from cm.formats.registers import MemoryInfo, RegisterField, RegisterInfo
from cm.frozen import dataclass

_PROCESSORS = ("processing_system7", "zynq_ultra_ps_e", "versal_cips")
_PS_INTERRUPTS = re.compile(r"IRQ_F2P|pl_ps_irq[01]|Core[01]_n(FIQ|IRQ)")
_CONSTANTS = ("xlconstant", "ilconstant")  # a bit that is nothing, as of GND_1
_DECOUPLERS = ("dfx_decoupler", "pr_decoupler")
_STREAM = ":axis:"  # in the VLNV of a stream's interface
_ECC = "S_AXI_CTRL"  # a BRAM controller's registers
_DEPTH = 8  # slices in a row
_WIDEST = 1024  # bits of one input of a concatenation
_GPIO_OUTPUTS = {"gpio_io_o": 0, "gpio2_io_o": 8}  # port → offset of its data register (PG144)
# The processors' GPIO on pins to the PL, as Linux' drivers/gpio/gpio-zynq.c has it: label of the chip, lines of EMIO.
_EMIO = {
    ("processing_system7", "GPIO_O"): ("zynq_gpio", range(54, 118)),
    ("zynq_ultra_ps_e", "emio_gpio_o"): ("zynqmp_gpio", range(78, 174)),
}


@dataclass(frozen=True, slots=True)
class InterruptLine:
    """An interrupt source. `index`: its bit at `controller` (an axi_intc), or at the PS port if that is None.

    `pin` is the port of the processor that it reaches: ``IRQ_F2P``, ``pl_ps_irq0``, ``pl_ps_irq1``, …
    `edge`: its source says that a rising edge is the interrupt, not a level.
    """

    instance: str
    port: str
    controller: str | None
    index: int
    pin: str = ""
    edge: bool = False


@dataclass(frozen=True, slots=True)
class DmaChannel:
    """One direction of a DMA engine; `base` is that of the engine's registers, `width` bits of its stream.

    Of an axi_dma: `scatter_gather` (Enable Scatter Gather Engine), and `length_bits` of its length register (PG021).
    An axi_mcdma has up to 16 of each direction, by `number`.
    """

    instance: str
    kind: str  # axi_dma, axi_vdma or axi_mcdma
    direction: str  # mm2s or s2mm
    base: int | None
    width: int
    scatter_gather: bool = True
    length_bits: int = 26
    number: int = 0

    @property
    def interrupt_port(self) -> str:
        """The engine's interrupt port."""
        channel = f"_ch{self.number + 1}" if self.kind == "axi_mcdma" else ""
        return f"{self.direction}{channel}_introut"

    @property
    def longest(self) -> int:
        """Bytes of one transfer at most."""
        return (1 << self.length_bits) - 1

    @property
    def limits(self) -> str:
        """What an engine without scatter/gather cannot do; empty if it has it."""
        if self.scatter_gather:
            return ""
        return (
            f"no scatter/gather (c_include_sg=0): one transfer of at most {self.longest} bytes at a time, and between "
            "two of them nothing is taken"
        )


@dataclass(frozen=True, slots=True)
class DecouplerInfo:
    """A DFX decoupler: the register bit or GPIO line that drives it (1 decouples), and the instances behind it."""

    instance: str
    base: int | None  # None: driven by something that is not a register of the PL
    offset: int
    bit: int
    driver: str  # instance that drives it
    neighbours: frozenset[str]  # instances on either side of it
    chip: str = ""  # label of the processor's GPIO chip whose `line` drives it
    line: int = 0


@dataclass(frozen=True, slots=True)
class ClockInfo:
    """A clock that the PS gives the PL, in Hz."""

    name: str
    rate: int


def processor(hwh: Hwh) -> ModuleInstance | None:
    """The processing system, where the design has one."""
    return next((module for module in hwh.modules.values() if module.type in _PROCESSORS), None)


def windows(hwh: Hwh) -> tuple[MemoryRange, ...]:
    """Register windows in the PL as the processor sees them, by address; in a partial's file, relative ones."""
    ps = processor(hwh)
    return _seen(hwh, lambda item: item.kind == "REGISTER" and (ps is None or item.instance != ps.instance))


def memories(hwh: Hwh) -> tuple[MemoryRange, ...]:
    """Block RAM behind AXI BRAM controllers (PG078), as `windows`, whatever kind the file gives the range."""
    return _seen(hwh, lambda item: _is_memory(hwh, item))


def _seen(hwh: Hwh, wanted: Callable[[MemoryRange], bool]) -> tuple[MemoryRange, ...]:
    ps = processor(hwh)
    kept = {(x.base, x.instance): x for x in (ps.ranges if ps else hwh.external_ranges) if wanted(x)}
    return tuple(kept[key] for key in sorted(kept))


def _is_memory(hwh: Hwh, item: MemoryRange) -> bool:
    module = hwh.modules.get(item.instance)
    return module is not None and module.type == "axi_bram_ctrl" and item.interface != _ECC


def _base(hwh: Hwh, instance: str) -> int | None:
    return next((item.base for item in windows(hwh) if item.instance == instance), None)


def _sources(hwh: Hwh, instance: str, port: str, seen: frozenset[str] = frozenset()) -> Iterator[ConnectedPort]:
    """What drives the bits of an input, lowest first; concatenations are looked through."""
    module = hwh.modules.get(instance)
    if module is None or port not in module.ports or instance in seen:
        return
    for end in module.ports[port].connections:
        driver = hwh.modules.get(end.instance)
        if driver is not None and driver.type in ("xlconcat", "ilconcat"):
            inputs = [name for name in driver.ports if re.fullmatch(r"[Ii]n\d+", name)]
            for name in sorted(inputs, key=lambda text: int(text[2:])):
                found = list(_sources(hwh, driver.instance, name, seen | {instance}))
                yield from found or [ConnectedPort("", "")] * min(driver.ports[name].width, _WIDEST)
        else:
            yield end


def interrupts(hwh: Hwh) -> tuple[InterruptLine, ...]:
    """Every interrupt that reaches the processor, also through axi_intc."""
    return tuple(line for line in _reaching(hwh) if not _controls(hwh, line))


def interrupt_controllers(hwh: Hwh) -> tuple[InterruptLine, ...]:
    """The output of each axi_intc that reaches the processor; its inputs are among `interrupts`."""
    return tuple(line for line in _reaching(hwh) if _controls(hwh, line))


def _controls(hwh: Hwh, line: InterruptLine) -> bool:
    module = hwh.modules.get(line.instance)
    return module is not None and module.type == "axi_intc" and line.controller is None


def _reaching(hwh: Hwh) -> Iterator[InterruptLine]:
    ps = processor(hwh)
    for pin in sorted(filter(_PS_INTERRUPTS.fullmatch, ps.ports)) if ps else ():
        assert ps
        yield from _lines(hwh, ps.instance, pin, None, pin)


def _lines(hwh: Hwh, instance: str, port: str, controller: str | None, pin: str) -> Iterator[InterruptLine]:
    for index, source in enumerate(_sources(hwh, instance, port)):
        driver = hwh.modules.get(source.instance)
        if driver is not None and driver.type == "axi_intc" and controller is None:
            yield InterruptLine(driver.instance, source.port, None, index, pin)
            yield from _lines(hwh, driver.instance, "intr", driver.instance, pin)
        elif source.instance and (driver is None or driver.type not in _CONSTANTS):
            port_of = driver.ports.get(source.port) if driver is not None else None
            edge = port_of is not None and port_of.sensitivity == "EDGE_RISING"
            yield InterruptLine(source.instance, source.port, controller, index, pin, edge)


def dma_channels(hwh: Hwh) -> tuple[DmaChannel, ...]:
    """The channels of every axi_dma, axi_vdma and axi_mcdma."""
    found = []
    for module in hwh.modules.values():
        if module.type in ("axi_dma", "axi_vdma", "axi_mcdma"):
            for direction, stream in (("mm2s", "M_AXIS_MM2S"), ("s2mm", "S_AXIS_S2MM")):
                if module.parameters.get(f"C_INCLUDE_{direction.upper()}", "1") != "0":
                    width = module.parameters.get(f"C_{stream}_TDATA_WIDTH", "")
                    base = _base(hwh, module.instance)
                    bits = int(width) if width.isdecimal() else 0
                    engine = _engine(module) if module.type != "axi_vdma" else (True, 26)
                    for number in range(_channels(module, direction)):
                        found.append(DmaChannel(module.instance, module.type, direction, base, bits, *engine, number))
    return tuple(found)


def stream_ends(hwh: Hwh, instance: str, interface: str = "") -> list[tuple[str, str]]:
    """Where an instance's AXI streams lead to, or that of one interface: instances and their interfaces."""
    module = hwh.modules.get(instance)
    out = [item.bus for item in module.interfaces if _sends(item) and interface in ("", item.name)] if module else []
    return [
        (other.instance, item.name)
        for bus in dict.fromkeys(out)
        for other in hwh.modules.values()
        for item in other.interfaces
        if item.bus == bus and item.type in ("SLAVE", "TARGET") and _STREAM in item.vlnv
    ]


def _sends(item: BusInterface) -> bool:
    return item.type in ("MASTER", "INITIATOR") and _STREAM in item.vlnv and item.bus not in ("", "__NOC__")


def _channels(module: ModuleInstance, direction: str) -> int:
    """How many channels an engine has in a direction."""
    name = f"C_NUM_{direction.upper()}_CHANNELS"
    text = module.parameters.get(name) or module.parameters.get(name.lower(), "")
    return min(max(int(text), 1), 16) if module.type == "axi_mcdma" and text.isdecimal() else 1


def _engine(module: ModuleInstance) -> tuple[bool, int]:
    """Whether there is scatter/gather, and the bits of the length register; as the core or its customisation says.

    A parameter that is missing has the core's default: scatter/gather, and 14 bits (PG021).
    """
    values = {key.lower(): value for key, value in module.parameters.items()}
    bits = values.get("c_sg_length_width", "")
    scattered = module.type == "axi_mcdma" or values.get("c_include_sg", "1") != "0"
    return scattered, min(max(int(bits), 8), 26) if bits.isdecimal() else 14


def decouplers(hwh: Hwh) -> tuple[DecouplerInfo, ...]:
    """Every DFX decoupler (pr_decoupler before 2020) and the register bit that drives it."""
    return tuple(_decoupler(hwh, module) for module in hwh.modules.values() if module.type in _DECOUPLERS)


def _decoupler(hwh: Hwh, module: ModuleInstance) -> DecouplerInfo:
    neighbours = frozenset(_neighbours(hwh, module))
    base = _base(hwh, module.instance)
    if base is not None:
        return DecouplerInfo(module.instance, base, 0, 0, module.instance, neighbours)  # PG375: bit 0 of register 0
    driver, output, bit = _source_bit(hwh, module.instance, "decouple")
    found = hwh.modules.get(driver)
    offset = _GPIO_OUTPUTS.get(output)
    if found is not None and found.type == "axi_gpio" and offset is not None:
        return DecouplerInfo(module.instance, _base(hwh, driver), offset, bit, driver, neighbours)
    chip, lines = _EMIO.get((found.type, output), ("", range(0))) if found is not None else ("", range(0))
    if bit < len(lines):
        return DecouplerInfo(module.instance, None, 0, 0, driver, neighbours, chip, lines[bit])
    return DecouplerInfo(module.instance, None, 0, 0, driver, neighbours)


def _source_bit(hwh: Hwh, instance: str, port: str) -> tuple[str, str, int]:
    """Follow an input through slices to what drives it: instance, port and bit of that; empty where nothing does."""
    bit = 0
    for _ in range(_DEPTH):
        module = hwh.modules.get(instance)
        ends = module.ports[port].connections if module is not None and port in module.ports else ()
        driver = hwh.modules.get(ends[0].instance) if ends else None
        if driver is None:
            return (ends[0].instance if ends else ""), "", 0
        if driver.type not in ("xlslice", "ilslice"):
            return driver.instance, ends[0].port, bit
        ends_of = (driver.parameters.get(key, "0") for key in ("DIN_FROM", "DIN_TO"))
        low = min(int(text) if text.isdecimal() else 0 for text in ends_of)
        bit, instance, port = bit + low, driver.instance, "Din"
    return "", "", 0


def _neighbours(hwh: Hwh, decoupler: ModuleInstance) -> Iterator[str]:
    """Instances that share a net with the decoupler: designs mix up which of its sides is which."""
    nets = {item.bus for item in decoupler.interfaces} - {"", "__NOC__"}
    ends = {end.instance for port in decoupler.ports.values() for end in port.connections}
    for name, module in hwh.modules.items():
        if name != decoupler.instance and (name in ends or any(item.bus in nets for item in module.interfaces)):
            yield name


def clocks(hwh: Hwh) -> tuple[ClockInfo, ...]:
    """The clocks of the PS for the PL (FCLK or PL clocks) that are switched on."""
    ps = processor(hwh)
    if ps is None:
        return ()
    found = []
    for index in range(4):
        for name, enable, rate in (
            (f"fclk{index}", f"PCW_FPGA_FCLK{index}_ENABLE", f"PCW_ACT_FPGA{index}_PERIPHERAL_FREQMHZ"),
            (f"pl{index}", f"PSU__FPGA_PL{index}_ENABLE", f"PSU__CRL_APB__PL{index}_REF_CTRL__ACT_FREQMHZ"),
        ):
            text = ps.parameters.get(rate, "")
            if ps.parameters.get(enable) == "1" and (text.isdecimal() or DECIMAL.fullmatch(text)):
                found.append(ClockInfo(name, round(float(text) * 1e6)))
    return tuple(found)


_GPIO = (
    (0x000, "GPIO_DATA", "Channel 1 data"),
    (0x004, "GPIO_TRI", "Channel 1 direction: 1 is input"),
    (0x11C, "GIER", "Bit 31: global interrupt enable"),
    (0x120, "IP_ISR", "Interrupt status, one bit a channel; 1 toggles"),
    (0x128, "IP_IER", "Interrupt enable, one bit a channel"),
)
_GPIO_DUAL = (
    (0x008, "GPIO2_DATA", "Channel 2 data"),
    (0x00C, "GPIO2_TRI", "Channel 2 direction: 1 is input"),
)
_TIMER = (
    (0x00, "TCSR0", "Timer 0 control and status"),
    (0x04, "TLR0", "Timer 0 load"),
    (0x08, "TCR0", "Timer 0 counter"),
    (0x10, "TCSR1", "Timer 1 control and status"),
    (0x14, "TLR1", "Timer 1 load"),
    (0x18, "TCR1", "Timer 1 counter"),
)
_READ_ONLY = {"TCR0", "TCR1"}


def registers(module: ModuleInstance, interface: str) -> tuple[RegisterInfo, ...]:
    """The registers that the instance describes behind this interface, or else those that its type is known to have."""
    described = module.registers.get(interface, ())
    if described:
        return described
    if module.type == "axi_gpio":
        dual = module.parameters.get("C_IS_DUAL") == "1"
        return _infos(sorted((*_GPIO, *(_GPIO_DUAL if dual else ()))))
    return _infos(_TIMER) if module.type == "axi_timer" else ()


def raw(module: ModuleInstance, window: MemoryRange) -> tuple[MemoryInfo, ...]:
    """A window of which no registers are described, as a memory of words; empty for what belongs to somebody else.

    Block RAM is a memory itself, and the manager alone moves what isolates a region.
    """
    if module.type in ("axi_bram_ctrl", "dfx_axi_shutdown_manager", *_DECOUPLERS):
        return ()
    doc = f"Window of {module.instance}, a {module.type}, without described registers"
    return (MemoryInfo(module.name, 0, window.size, doc=doc),)


_FIELDS = {
    "IP_ISR": (("CHANNEL_1", 0, "oneToToggle"), ("CHANNEL_2", 1, "oneToToggle")),
    **dict.fromkeys(
        ("TCSR0", "TCSR1"),
        (
            ("DOWN", 1, ""),
            ("AUTO_RELOAD", 4, ""),
            ("LOAD", 5, ""),
            ("INTERRUPT_ENABLE", 6, ""),
            ("ENABLE", 7, ""),
            ("INTERRUPT", 8, "oneToClear"),
        ),
    ),
}


def _infos(rows: tuple[tuple[int, str, str], ...] | list[tuple[int, str, str]]) -> tuple[RegisterInfo, ...]:
    return tuple(
        RegisterInfo(
            name,
            offset,
            32,
            "read-only" if name in _READ_ONLY else "read-write",
            fields=tuple(RegisterField(part, bit, 1, write=write) for part, bit, write in _FIELDS.get(name, ())),
            doc=doc,
        )
        for offset, name, doc in rows
    )
