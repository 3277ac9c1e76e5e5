# SPDX-License-Identifier: Apache-2.0
"""What Vivado would build: the engines as the generated Tcl of a block design orders them, for the model of them.

An overlay is wrong where it disagrees with this, which is what the hardware is made from.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

# first SPI of each group of eight lines: UG585 table 7-4, UG1085 table 13-1
FIRST_SPI = {"zynq7000": (29, 52), "zynqmp": (89, 104)}


@dataclass(frozen=True, slots=True)
class Engine:
    """One AXI DMA, MCDMA or VDMA as it was built."""

    name: str
    settings: dict[str, int]  # CONFIG.*
    address: int
    lines: dict[str, tuple[int, int]]  # mm2s, s2mm, mm2s_ch1 … → group and input
    ip: str = "axi_dma"

    @property
    def sends(self) -> bool:
        """It has MM2S."""
        return bool(self.settings["c_include_mm2s"])

    @property
    def receives(self) -> bool:
        """It has S2MM."""
        return bool(self.settings["c_include_s2mm"])


@dataclass(frozen=True, slots=True)
class Pl:
    """What is at the engines' streams, which a block design does not say."""

    frame_bytes: int
    interval_us: int
    idcode: int
    status: int  # address of the port's status register
    identity: int  # address of the region's identity register


def engines(tcl: str, static: str = "") -> list[Engine]:
    """The DMA engines of a block design's Tcl; `static` is the static part's Verilog, which joins lines."""
    addresses = {
        name: int(base, 16) for base, name in re.findall(r"-offset (\S+) .*get_bd_addr_segs (\w+)/S_AXI_LITE/Reg", tcl)
    }
    return [
        Engine(name, _settings(tcl, name), addresses[name], _lines(tcl, static, name), ip)
        for ip, name in re.findall(r"cm_ip (axi_(?:|mc|v)dma) (\w+)\]", tcl)
    ]


def _settings(tcl: str, cell: str) -> dict[str, int]:
    after = re.split(rf"cm_ip \w+ {cell}\]", tcl, maxsplit=1)[1].split("cm_ip", 1)[0]
    return {name: int(value) for name, value in re.findall(r"CONFIG\.(c_\w+) \{(\d+)\} \$dma", after)}


def _lines(tcl: str, static: str, cell: str) -> dict[str, tuple[int, int]]:
    """Where each interrupt ends: at an input of a bundle, or joined with others in the static part."""
    inputs = dict(re.findall(r"get_bd_p\w+ (\S+)\] \[get_bd_pins interrupt_lines_(\d/In\d+)\]", tcl))
    joined = {
        port: line
        for line, ports in re.findall(r"assign (irq_line_\d+) = ([^;]*);", static)
        for port in ports.split(" | ")
    }
    found = {}
    for channel, port in re.findall(rf"get_bd_pins {cell}/(\w+)_introut\] \[get_bd_ports (\w+)\]", tcl):
        found[channel] = inputs[joined[port]]
    for pin, bundle in inputs.items():
        if pin.startswith(f"{cell}/"):
            found[pin.removeprefix(f"{cell}/").removesuffix("_introut")] = bundle
    return {channel: _input(bundle) for channel, bundle in found.items()}


def _input(bundle: str) -> tuple[int, int]:
    group, _, number = bundle.partition("/In")
    return int(group), int(number)


def overlay(found: list[Engine], pl: Pl, platform: str, controller: str) -> str:
    """The source of an overlay for cm_axi_model; `controller`: label of the interrupt controller."""
    nodes = "\n".join(_node(engine, pl, FIRST_SPI[platform], controller) for engine in found)
    return f"""/dts-v1/;
/plugin/;
&{{/}} {{
	built-hardware {{
		compatible = "fpga-cm,axi-model";
		interrupt-controller;
		#interrupt-cells = <1>;
		#address-cells = <1>;
		#size-cells = <0>;
{nodes}
	}};
}};
"""


def _node(engine: Engine, pl: Pl, first: tuple[int, int], controller: str) -> str:
    interrupts = ", ".join(f"<&{controller} 0 {first[group] + line} 4>" for group, line in engine.lines.values())
    names = ", ".join(f'"{channel}"' for channel in engine.lines)
    lines = [
        f"engine@{engine.address:x} {{",
        f"reg = <{engine.address:#x}>;",
        f'label = "{engine.name.removeprefix("dma_")}";',
        *(f"fpga-cm,length-width = <{width}>;" for width in [engine.settings.get("c_sg_length_width")] if width),
        *(["fpga-cm,sg;"] if engine.settings.get("c_include_sg") else []),
        *([] if engine.ip == "axi_dma" else [f"fpga-cm,{engine.ip.removeprefix('axi_')};"]),
        *([] if engine.sends else ["fpga-cm,no-mm2s;"]),
        *([] if engine.receives else ["fpga-cm,no-s2mm;"]),
        f"interrupts-extended = {interrupts};",
        f"interrupt-names = {names};",
        *_behind(engine, pl),
        "};",
    ]
    return "\n".join(f"\t\t{line}" for line in lines)


def _behind(engine: Engine, pl: Pl) -> list[str]:
    if engine.name == "dma_icap":
        port = f"fpga-cm,idcode = <{pl.idcode:#x}>; fpga-cm,status = <{pl.status:#x}>;"
        return ['fpga-cm,pl = "port";', port, f"fpga-cm,identity = <{pl.identity:#x}>;"]
    if engine.receives and not engine.sends:
        camera = f"fpga-cm,frame-length = <{pl.frame_bytes}>; fpga-cm,interval-us = <{pl.interval_us}>;"
        return ['fpga-cm,pl = "camera";', camera]
    return ['fpga-cm,pl = "loop";']
