# SPDX-License-Identifier: Apache-2.0
"""Registers whose file and HDL come from one generator: written and read by field, beside what its description says."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest
from conftest import needs, served

import cm
from cm.client.errors import RequestInvalid

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]

RDL = """
enum speeds { off = 0; slow = 1; fast = 2; };
addrmap device_regs {
  default hw = r;
  reg {
    field { encode = speeds; } speed[1:0] = 1; field { } gain[15:8] = 0x5A; field { sw = r; hw = w; } load[23:16];
    field { onwrite = woclr; hwset; } overrun[24:24] = 0; field { singlepulse; } go[25:25] = 0;
    field { onwrite = wot; } led[26:26] = 1;
  } control;
  reg { field { } limit[15:0] = 3; field { sw = r; onread = rclr; hwset; } seen[16:16] = 0; } events;
};
"""
REGBLOCK = """
from peakrdl_regblock import RegblockExporter, udps
from peakrdl_regblock.cpuif.axi4lite import AXI4Lite_Cpuif_flattened
from systemrdl import RDLCompiler
compiler = RDLCompiler()
for udp in udps.ALL_UDPS:
    compiler.register_udp(udp)
compiler.compile_file("device.rdl")
RegblockExporter().export(compiler.elaborate(), ".", cpuif_cls=AXI4Lite_Cpuif_flattened)
"""
REGBLOCK_TOP = """
    device_regs_pkg::device_regs__in_t in;
    device_regs_pkg::device_regs__out_t out;
    assign in.control.load.next = ~out.control.gain.value, in.control.overrun.hwset = out.control.go.value;
    assign in.events.seen.hwset = out.control.go.value;
    device_regs regs (.rst(!resetn), .hwif_in(in), .hwif_out(out), .*);"""
AXION_YAML = """
module: device
registers:
  - name: control
    addr: 0x0
    fields:
      - {name: speed, bit_offset: 0, width: 2, access: RW, default: 1, enum_values: {0: "off", 1: slow, 2: fast}}
      - {name: gain, bit_offset: 8, width: 8, access: RW, default: 0x5A}
      - {name: load, bit_offset: 16, width: 8, access: RO}
  - {name: go, addr: 0x4, access: WO, width: 32}
  - {name: total, addr: 0x8, access: RO, width: 64}
  - {name: limit, addr: 0x10, access: RW, width: 32, default: 3}
"""
AXION = """
from axion_hdl import AxionHDL
tool = AxionHDL(".")
tool.add_yaml_src("device.yaml")
assert tool.analyze() and tool.generate_systemverilog() and tool.generate_json()
"""
AXION_TOP = """
    logic [7:0] control_gain;
    logic [31:0] go;
    device_axion_reg regs (.control_load(~control_gain), .total({go, ~go}), .control_speed(), .limit(), .*);
"""
LITEX = """
from litex.build.generic_platform import GenericPlatform, Pins
from litex.build.io import CRG
from litex.gen import LiteXModule
from litex.soc.integration.export import get_csr_json
from litex.soc.integration.soc_core import SoCMini
from litex.soc.interconnect.axi import AXILiteInterface
from litex.soc.interconnect.csr import CSRField, CSRStatus, CSRStorage
from litex.soc.interconnect.csr_eventmanager import EventManager, EventSourcePulse
class Device(LiteXModule):
    def __init__(self):
        self.control = CSRStorage(fields=[CSRField("speed", 2, reset=1), CSRField("gain", 8, offset=8, reset=0x5A)])
        self.load = CSRStatus(8)
        self.go = CSRStorage()
        self.wide = CSRStorage(64, reset=0x2_0000_0001)
        self.ev = EventManager()
        self.ev.overrun = EventSourcePulse()
        self.ev.finalize()
        self.comb += [self.load.status.eq(~self.control.fields.gain), self.ev.overrun.trigger.eq(self.go.re)]
class Design(SoCMini):
    csr_map = {"dev": 1}  # nothing is at the beginning of the window
    def __init__(self):
        bus = AXILiteInterface(32, 16)
        pads = GenericPlatform("", [("clk", 0, Pins(1)), ("resetn", 0, Pins(1)), *bus.get_ios("s_axi")])
        super().__init__(pads, int(1e6), bus_standard="axi-lite", csr_data_width=32, ident="", with_ctrl=False)
        self.crg, self.dev = CRG(pads.request("clk"), ~pads.request("resetn")), Device()
        self.comb += bus.connect_to_pads(pads.request("s_axi"), mode="slave")
        self.bus.add_master(name="outside", master=bus)
design = Design()
design.finalize()
open("csr.json", "w").write(get_csr_json(design.csr_regions, design.constants, design.mem_regions))
design.platform.get_verilog(design, name="litex").write("litex.v")
"""
PORTS = """(input logic BUS_awvalid, BUS_wvalid, BUS_bready, BUS_arvalid, BUS_rready, input logic [31:0] BUS_wdata,
    output logic BUS_awready, BUS_wready, BUS_bvalid, BUS_arready, BUS_rvalid, output logic [1:0] BUS_bresp, BUS_rresp,
    input logic [2:0] BUS_awprot, BUS_arprot, input logic [3:0] BUS_wstrb, output logic [31:0] BUS_rdata"""


class Generator(NamedTuple):
    """A script that makes `made` of `given`, and what the description says of fields: access, bits, value after reset.

    `driven`: what the hardware round the registers drives after a field was written.
    """

    package: str
    script: str
    given: dict[str, str]
    made: list[str]
    fields: dict[str, tuple[str, int, int]]
    driven: Callable[[dict[str, int], str], dict[str, int]]


CONTROL = {"control.speed": ("rw", 2, 1), "control.gain": ("rw", 8, 0x5A), "control.load": ("ro", 8, 0)}
_REGBLOCK = f"module regblock {PORTS}, input clk, resetn, input [2:0] BUS_awaddr, BUS_araddr);{REGBLOCK_TOP} endmodule"
_AXION = f"module axion {PORTS}, input axi_aclk, axi_aresetn, input [31:0] BUS_awaddr, BUS_araddr);{AXION_TOP}endmodule"
GENERATORS = {
    "regblock": Generator(
        *("peakrdl_regblock", REGBLOCK, {"device.rdl": RDL, "top.sv": _REGBLOCK.replace("BUS", "s_axil")}),
        ["device.rdl", "device_regs_pkg.sv", "device_regs.sv", "top.sv"],
        {**CONTROL, "control.overrun": ("w1c", 1, 0), "control.go": ("pulse", 1, 0), "control.led": ("w1t", 1, 1)}
        | {"events.limit": ("rw", 16, 3), "events.seen": ("rc", 1, 0)},
        lambda state, field: (
            {"control.load": ~state["control.gain"] & 0xFF} | ({"control.overrun": 1} if field == "control.go" else {})
        ),
    ),
    "axion": Generator(
        *("axion_hdl", AXION, {"device.yaml": AXION_YAML, "top.sv": _AXION.replace("BUS", "axi")}),
        ["device_regs.json", "device_axion_reg.sv", "top.sv"],
        CONTROL | {"go": ("wo", 32, 0), "total_0": ("ro", 32, 0), "total_1": ("ro", 32, 0), "limit": ("rw", 32, 3)},
        lambda state, _: (
            {"control.load": ~state["control.gain"] & 0xFF}
            | {"total_0": ~state["go"] & 0xFFFF_FFFF, "total_1": state["go"]}
        ),
    ),
    "litex": Generator(
        *("litex", LITEX, {}, ["csr.json", "litex.v"]),
        {"dev_control": ("rw", 16, 0x5A01), "dev_load": ("ro", 8, 0), "dev_go": ("rw", 1, 0)}
        | {"dev_wide_1": ("rw", 32, 2), "dev_wide_0": ("rw", 32, 1), "dev_ev_status": ("ro", 1, 0)}
        | {"dev_ev_pending": ("w1c", 1, 0), "dev_ev_enable": ("rw", 1, 0)},
        lambda state, field: (
            {"dev_load": ~(state["dev_control"] >> 8) & 0xFF} | ({"dev_ev_pending": 1} if field == "dev_go" else {})
        ),
    ),
}
INSTALLED = {name: one for name, one in GENERATORS.items() if importlib.util.find_spec(one.package)}


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    """A region with a module and a mode of each generator."""
    folder, modules = tmp_path_factory.mktemp("design"), {}
    for name, one in INSTALLED.items():
        (folder / name).mkdir()
        for file, text in one.given.items():
            (folder / name / file).write_text(text)
        command = [sys.executable, "-W", "ignore", "-c", one.script]
        done = subprocess.run(command, cwd=folder / name, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        registers, *sources = [f"{name}/{file}" for file in one.made]
        modules[name] = {"sources": sources, "register_map": registers, "resources": {"lut": 500, "ff": 500}}
    schema = {
        "project": {"name": "generated", "part": "xc7z020clg400-1"},
        "regions": {"prr0": {"pblock": "auto", "resources": {"lut": 1000, "ff": 1000}}},
        "modules": modules,
        "modes": {name: {"modules": [name]} for name in modules},
    }
    (folder / "build.yaml").write_text(json.dumps(schema))
    with served(tmp_path_factory.mktemp("run"), folder / "build.yaml", "generated") as connected:
        yield connected


def there(name: str) -> Any:
    """A generator by name, skipped where it is not installed."""
    why = f"needs {GENERATORS[name].package}: the extra [test-rtl] is not installed"
    return pytest.param(name, marks=pytest.mark.skipif(name not in INSTALLED, reason=why))


@pytest.mark.parametrize("name", [there(name) for name in GENERATORS])
def test_each_field_is_what_its_description_says_and_leaves_the_others_alone(board: cm.Board, name: str) -> None:
    fields, driven = GENERATORS[name].fields, GENERATORS[name].driven
    board.set_mode(name)
    info = board.registers.info.items()
    names = {one for r, has in info for one in ([f"{r}.{part.name}" for part in has.fields] or [r])}
    assert {one for one in names if not one.startswith("cm_")} == fields.keys()
    assert all(fields[r][0] == has.access for r, has in info if r in fields)
    state = {field: reset for field, (_, _, reset) in fields.items()}
    state |= driven(state, "")
    readable = [field for field, (access, _, _) in fields.items() if access not in ("wo", "rc")]
    assert board.registers.read(*readable) == {field: state[field] for field in readable}
    for field, (access, width, _) in fields.items():
        if access in ("ro", "rc"):
            with pytest.raises(RequestInvalid, match="is read-only"):
                board.registers[field] = 1
            continue
        for value in (0, (1 << width) - 1, 0xA5C3_9601 & ((1 << width) - 1)):
            board.registers[field] = value
            old = state[field]
            state[field] = {"w1c": old & ~value, "w1t": old ^ value, "pulse": 0}.get(access, value)
            state |= driven(state, field if value or access != "pulse" else "")
            assert board.registers.read(*readable) == {one: state[one] for one in readable}, (field, value)
    if "control.speed" in fields:
        board.registers["control.speed"] = "fast"
        assert board.registers.read(*readable) == {one: state[one] for one in readable} | {"control.speed": 2}


@pytest.mark.parametrize("name", [there("regblock")])
def test_what_reading_clears_stays_until_it_is_read_whatever_is_written_beside_it(board: cm.Board, name: str) -> None:
    board.set_mode(name)
    board.registers["control.go"] = 1
    board.registers["events.limit"] = 5
    assert [board.registers[one] for one in ("events.seen", "events.seen", "events.limit")] == [1, 0, 5]
