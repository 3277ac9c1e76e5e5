# SPDX-License-Identifier: Apache-2.0
"""Generated files for the target: device tree, kernel configuration, recipes, register symbols, runtime schema.

Widths of the AXI ports between processing system and PL, as linux-xlnx's drivers set them.

The boot loader sets them from the hardware description that it was built with; a design that is loaded later may need
others. The widths here are those that `block_design` uses.

- UltraScale+: ``config-afi`` of linux-xlnx's drivers/fpga/xilinx-afi.c, pairs of a register of PM_AFI and its value:
  2n and 2n+1 are AFIFM<n>.RDCTRL and WRCTRL (0, 1: HPC; 2 to 5: HP), 0 for 128 bits; 14 is FPD_SLCR.afi_fs, 0xa00
  for 128 bits at both HPM ports (UG1085, UG1087).
- Zynq-7000: one node for each port, 0 for 64 bits (drivers/fpga/zynq-afi.c reads ``xlnx,afi-width``, its binding says
  ``xlnx,afi-buswidth``: both stand here); AFI0 to AFI3 are at 0xf8008000 and every 0x1000 behind (UG585, appendix B.3).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from cm.design.generate.dma_nodes import Channel, ClockInput, Streams, Tree, pl_clock, streams_of
from cm.design.generate.dma_nodes import Engine as EngineNode
from cm.design.plan.block_design import memory_ports
from cm.design.plan.dma_cells import FRAME_STORES, clock_pins
from cm.design.plan.dma_engines import Dma, Engine, EngineKind
from cm.design.plan.system import Implementation, RegionPlan, System, used_clocks
from cm.design.render import c_name
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import REGION_BLOCK, REGION_STRIDE, runtime_config, runtime_text
from cm.formats.bitstream import device_by_name
from cm.schema.model import Config, LoaderKind, Memory, Register

_AFI_FS, _AFI_FS_128 = 14, 0xA00
_AFI_BASE = 0xF8008000


Node = tuple[str, tuple[str, ...]]  # its name, and the lines in it


def nodes(system: System) -> list[Node]:
    """The nodes for the ports that a system uses."""
    ports = [port for port, _ in memory_ports(system)]
    if system.platform.ultrascale:
        pairs = [(2 * port.number + channel, 0) for port in ports for channel in (0, 1)]
        listed = ", ".join(f"<{register} {value:#x}>" for register, value in [*pairs, (_AFI_FS, _AFI_FS_128)])
        return [("cm-afi", ('compatible = "xlnx,afi-fpga";', f"config-afi = {listed};"))]
    bases = [_AFI_BASE + 0x1000 * port.number for port in ports]
    widths = ("xlnx,afi-width = <0>;", "xlnx,afi-buswidth = <0>;")
    return [
        (f"cm-afi@{base:x}", ('compatible = "xlnx,zynq-afi-fpga";', f"reg = <{base:#010x} 0x1000>;", *widths))
        for base in bases
    ]


PAGE = 0x1000
Entry = tuple[str, str, Mapping[str, Any]]  # path below the output folder, template, its variables


def software_outputs(system: System, answers: Answers) -> Iterator[Entry]:
    """Path, template and its variables of every file."""
    name = system.project.name
    config = runtime_config(system, answers)
    dt = _DeviceTree(system)
    base: dict[str, Any] = {"system": system, "config": config, "name": name, "dt": dt}
    base |= {"clocks": dt.clocks, "engines": dt.engines.values(), "streams": dt.streams}
    yield f"config/{name}.yaml", "runtime.yaml.j2", base | {"text": runtime_text(system, config)}
    yield f"dts/{name}_static.dtso", "static.dtso.j2", base
    yield "dts/system-user.dtsi", "system-user.dtsi.j2", base
    for one in system.implementations:
        yield (
            f"dts/{'' if dt.firmware(one) else 'module_'}{one.name}.dtso",  # what loads a module has its name
            "module.dtso.j2",
            base | {"implementations": [one], "title": f"module {one.name}"},
        )
    symbols = base | {"blocks": list(_blocks(system, config))}
    yield f"include/{name}_registers.h", "registers.h.j2", symbols
    yield f"python/{name}_registers.py", "registers.py.j2", symbols
    yield "kernel/cm.cfg", "kernel.cfg.j2", base
    recipe = f"cm-config-{name.replace('_', '-')}"
    yield f"yocto/{recipe}/{recipe}_1.0.bb", "recipe.bb.j2", base | {"recipe": recipe}
    yield "petalinux/README.md", "petalinux.md.j2", base | {"recipe": recipe}
    yield "petalinux/user-rootfsconfig", "rootfsconfig.j2", {"recipe": recipe}


class _DeviceTree(Tree):
    """Device-tree properties of a system."""

    def __init__(self, system: System) -> None:
        super().__init__(system.platform)
        self._system = system
        known = device_by_name(system.device)
        self.idcode = known.idcode if known else 0
        self.engines = {engine.name: self._engine(engine) for engine in system.engines}

    def clock(self, name: str) -> str:
        """The phandle of a PL clock, with its argument."""
        return pl_clock(self.zynq, list(self._system.project.clocks).index(name))

    @property
    def clocks(self) -> list[ClockInput]:
        """The PL clocks in use."""
        clocks = self._system.project.clocks
        return [ClockInput(name, self.clock(name), clocks[name].rate) for name in used_clocks(self._system)]

    @property
    def afi(self) -> list[Node]:
        """Nodes that set the widths of the ports between PS and PL."""
        return nodes(self._system)

    @property
    def own_windows(self) -> list[tuple[int, int]]:
        """Where the registers under `static:` are, in whole pages: base and size of each run of them."""
        given = self._system.project.static.registers.values()
        pages = {register.address // PAGE for register in given}  # aligned to their width, so each is on one page
        control = self._system.control
        pages -= set(range(control.base // PAGE, (control.base + control.size) // PAGE))
        begins = [page for page in sorted(pages) if page - 1 not in pages]
        ends = [page + 1 for page in sorted(pages) if page + 1 not in pages]
        return [(PAGE * begin, PAGE * (end - begin)) for begin, end in zip(begins, ends, strict=True)]

    def region(self, region: RegionPlan) -> str:
        """Name of a region's node: the kernel's binding allows ``fpga-region-<number>``."""
        return f"fpga-region-{region.index}"

    def interrupt(self, line: int) -> str:
        """An interrupt of the PL, level high."""
        return f"<0 {self._system.platform.spi(line)} 4>"

    def block(self, index: int) -> int:
        """Address of a region's control registers."""
        return self._system.control.base + REGION_BLOCK + REGION_STRIDE * index

    def _engine(self, engine: Engine) -> EngineNode:
        """An engine's node; an MCDMA's one clock is listed as the three of its driver."""
        pins = list(clock_pins(engine))
        if engine.kind is EngineKind.MCDMA:
            pins[1:] = ["m_axi_sg_aclk", *(f"m_axi_{way.value}_aclk" for way in engine.directions)]
        return EngineNode(
            label=f"cm_dma_{engine.name}",
            kind=engine.kind.value,
            base=engine.window.base,
            size=engine.window.size,
            address_bits=self._system.platform.address_bits,
            length_bits=engine.length_bits,
            frames=FRAME_STORES,
            flushes=True,  # as the core does unless told
            clocks=tuple(ClockInput(pin, self.clock(engine.clock)) for pin in pins),
            channels=tuple(self._channel(dma) for way in engine.directions for dma in engine.of(way)),
            coherent=self._system.project.static.coherent,
        )

    def _channel(self, dma: Dma) -> Channel:
        line = self.spi(self._system.platform.spi(dma.line))
        return Channel(dma.name, dma.direction.value, line, dma.memory_width, False, dma.cell)

    @property
    def streams(self) -> list[Streams]:
        """Channels of streams."""
        found = [dma for dma in self._system.dmas if dma not in (self._system.icap, self._system.readback)]
        return streams_of([(self.engines[dma.engine or dma.name], self._channel(dma)) for dma in found])

    def firmware(self, one: Implementation) -> bool:
        """Whether the kernel loads the bitstream when the overlay is applied."""
        return one.region.spec.loader is LoaderKind.OVERLAY

    def label(self, text: str) -> str:
        """A node name: letters, digits and dashes."""
        return text.replace("_", "-")


Symbol = tuple[str, str, str]  # name behind the block's, value, what it is


def _blocks(system: System, config: Config) -> Iterator[dict[str, Any]]:
    """Registers and memories with their symbols, per module and for the static part; each symbol is there once."""
    taken: set[str] = set()
    parts = [("control", "static part", system.control.base, config.registers, config.memories)]
    for name, module in config.modules.items():
        bases = [register.base_address for register in module.registers.values()]
        bases += [memory.base_address for memory in module.memories.values()]
        parts += [(name, module.doc, min(bases), module.registers, module.memories)] if bases else []
    for name, doc, base, registers, memories in parts:
        block = _free(c_name(name), taken)
        symbols = [("BASE", f"0x{base:08X}", ""), *_register_symbols(registers, base), *_memory_symbols(memories, base)]
        yield {
            "name": name,
            "doc": _line(doc),
            "symbol": block,
            "symbols": [
                (_free(f"{block}_{end}", taken)[len(block) + 1 :], value, what) for end, value, what in symbols
            ],
        }


def _free(name: str, taken: set[str]) -> str:
    """`name`, or with as many underscores behind it as it takes to be a new one, which is then taken."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _line(text: str) -> str:
    """`text` as it can stand in a comment of C."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *")


def _register_symbols(registers: Mapping[str, Register], base: int) -> Iterator[Symbol]:
    for register in sorted(registers.values(), key=lambda register: (register.offset, register.name)):
        name, doc = c_name(register.name), _line(register.doc)
        what = f"{register.width} bit, {register.access.value}{f': {doc}' if doc else ''}"
        yield name, f"0x{register.address - base:02X}", what
        for field in register.fields.values():
            yield f"{name}_{c_name(field.name)}_SHIFT", str(field.lsb), ""
            yield f"{name}_{c_name(field.name)}_MASK", f"{field.mask:#x}", ""
            for word, number in field.values.items():
                yield f"{name}_{c_name(field.name)}_{c_name(word)}", str(number), ""


def _memory_symbols(memories: Mapping[str, Memory], base: int) -> Iterator[Symbol]:
    for memory in sorted(memories.values(), key=lambda memory: (memory.address, memory.name)):
        doc = _line(memory.doc)
        yield c_name(memory.name), f"0x{memory.address - base:02X}", f"{memory.size} bytes{f': {doc}' if doc else ''}"
