# SPDX-License-Identifier: Apache-2.0
"""Registers read from other tools' descriptions."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import MINIMAL, project
from import_support import described, hwh, module, register, register_field

from cm.design.errors import BuildError
from cm.design.hdl.register_maps import read_register_map
from cm.schema.model import Access, FieldAccess

IPXACT = """<?xml version="1.0" encoding="UTF-8"?>
<spirit:component xmlns:spirit="http://www.spiritconsortium.org/XMLSchema/SPIRIT/1685-2009">
 <spirit:memoryMaps><spirit:memoryMap><spirit:name>S_AXI</spirit:name><spirit:addressBlock>
  <spirit:name>reg0</spirit:name><spirit:baseAddress>0x100</spirit:baseAddress>
  <spirit:register><spirit:name>Status Word</spirit:name><spirit:description>What  happened</spirit:description>
   <spirit:addressOffset>0x8</spirit:addressOffset><spirit:size>32</spirit:size><spirit:access>read-only</spirit:access>
   <spirit:reset><spirit:value>0x5</spirit:value></spirit:reset>
   <spirit:field><spirit:name>DONE</spirit:name><spirit:bitOffset>3</spirit:bitOffset><spirit:bitWidth>2</spirit:bitWidth>
   </spirit:field></spirit:register>
 </spirit:addressBlock></spirit:memoryMap></spirit:memoryMaps></spirit:component>
"""

HLS = """\
// control
// 0x00 : Control signals
//        bit 0  - ap_start (Read/Write/COH)
// 0x10 : Data signal of gain
//        bit 31~0 - gain[31:0] (Read/Write)
// 0x18 : Data signal of sum
//        bit 31~0 - sum[31:0] (Read)
#define XFILTER_CONTROL_ADDR_AP_CTRL   0x00
#define XFILTER_CONTROL_ADDR_GAIN_DATA 0x10
#define XFILTER_CONTROL_BITS_GAIN_DATA 32
#define XFILTER_CONTROL_ADDR_SUM_DATA  0x18
#define XFILTER_CONTROL_BITS_SUM_DATA  32
#define XFILTER_CONTROL_ADDR_TABLE_BASE 0x40
#define XFILTER_CONTROL_ADDR_TABLE_HIGH 0x7f
"""

# As Vivado HLS 2018 to 2020 and Vitis HLS 2021 to 2024 write them: names and addresses of the authors' own files, words
# of their comments by version.
S_AXI = {
    "2019": """\
//------------------------Address Info-------------------
// 0x00 : Control signals
//        bit 0  - ap_start (Read/Write/COH)
//        bit 1  - ap_done (Read/COR)
//        bit 2  - ap_idle (Read)
//        bit 3  - ap_ready (Read)
//        bit 7  - auto_restart (Read/Write)
//        others - reserved
// 0x04 : Global Interrupt Enable Register
//        bit 0  - Global Interrupt Enable (Read/Write)
//        others - reserved
// 0x08 : IP Interrupt Enable Register (Read/Write)
//        bit 0  - Channel 0 (ap_done)
//        bit 1  - Channel 1 (ap_ready)
//        others - reserved
// 0x0c : IP Interrupt Status Register (Read/TOW)
//        bit 0  - Channel 0 (ap_done)
//        bit 1  - Channel 1 (ap_ready)
//        others - reserved
// 0x10 : Data signal of gain
//        bit 31~0 - gain[31:0] (Read/Write)
// 0x14 : reserved
// 0x18 : Data signal of where_r
//        bit 31~0 - where_r[31:0] (Read/Write)
// 0x1c : Data signal of where_r
//        bit 31~0 - where_r[63:32] (Read/Write)
// 0x20 : reserved
// 0x24 : Data signal of sum
//        bit 15~0 - sum[15:0] (Read)
//        others   - reserved
// 0x28 : Control signal of sum
//        bit 0  - sum_ap_vld (Read/COR)
//        others - reserved
// 0x40 ~
// 0x7f : Memory 'table' (16 * 32b)
//        Word n : bit [31:0] - table[n]
// (SC = Self Clear, COR = Clear on Read, TOW = Toggle on Write, COH = Clear on Handshake)

//------------------------Parameter----------------------
localparam
    ADDR_AP_CTRL       = 7'h00,
    ADDR_GIE           = 7'h04,
    ADDR_IER           = 7'h08,
    ADDR_ISR           = 7'h0c,
    ADDR_GAIN_DATA_0   = 7'h10,
    ADDR_GAIN_CTRL     = 7'h14,
    ADDR_WHERE_R_DATA_0 = 7'h18,
    ADDR_WHERE_R_DATA_1 = 7'h1c,
    ADDR_SUM_DATA_0    = 7'h24,
    ADDR_SUM_CTRL      = 7'h28,
    ADDR_TABLE_BASE    = 7'h40,
    ADDR_TABLE_HIGH    = 7'h7f;
""",
}
S_AXI["2024"] = (
    S_AXI["2019"]
    .replace("- ap_ready (Read)", "- ap_ready (Read/COR)")
    .replace("//        bit 7  - auto", "//        bit 7  - auto")
    .replace("Channel 0 (ap_done)\n", "enable ap_done interrupt (Read/Write)\n", 1)
    .replace("Channel 1 (ap_ready)\n", "enable ap_ready interrupt (Read/Write)\n", 1)
    .replace("Channel 0 (ap_done)\n", "ap_done (Read/TOW)\n")
    .replace("Channel 1 (ap_ready)\n", "ap_ready (Read/TOW)\n")
)
S_AXI["vhdl"] = "\n".join(
    line.replace("//", "--", 1) for line in S_AXI["2019"].split("//------------------------Parameter")[0].splitlines()
)

RDL = """\
addrmap filter {
    reg { field { sw = rw; hw = r; } value[7:0] = 8'h10; } gain @ 0x4;
    reg { field { sw = r; hw = w; } busy; field { sw = rw; onwrite = woclr; hw = w; } error[5:4]; } state @ 0x8;
};
"""


def test_ip_xact(tmp_path: Path) -> None:
    (tmp_path / "component.xml").write_text(IPXACT)
    found = read_register_map(tmp_path / "component.xml", "any")[0]["status_word"]
    assert (found.base_address, found.offset, found.width, found.access, found.reset) == (0, 0x108, 32, Access.RO, 5)
    assert (found.fields["done"].lsb, found.fields["done"].width) == (3, 2)
    assert found.doc == "What happened"


def test_hardware_handoff(tmp_path: Path) -> None:
    text = hwh(module("f0", "filter", described(register("GAIN", 8, register_field("LOW", 0, 4), size=8))))
    (tmp_path / "a.hwh").write_bytes(text)
    found = read_register_map(tmp_path / "a.hwh", "filter")[0]["gain"]
    assert (found.offset, found.width, found.fields["low"].width) == (8, 32, 4)


def test_hls_header(tmp_path: Path) -> None:
    (tmp_path / "xfilter_hw.h").write_text(HLS)
    found = read_register_map(tmp_path / "xfilter_hw.h", "filter")[0]
    assert {name: (one.offset, one.access) for name, one in found.items()} == {
        "ap_ctrl": (0, Access.RW),
        "gain": (0x10, Access.RW),
        "sum": (0x18, Access.RO),
    }


@pytest.mark.parametrize("style", sorted(S_AXI))
def test_registers_of_hls_are_those_of_its_comment(style: str, tmp_path: Path) -> None:
    path = tmp_path / f"filter_control_s_axi.{'vhd' if style == 'vhdl' else 'v'}"
    path.write_text(S_AXI[style])
    found = read_register_map(path, "filter")[0]
    assert {name: (one.offset, one.access.value) for name, one in found.items()} == {
        "ap_ctrl": (0, "rw"), "gie": (4, "rw"), "ier": (8, "rw"), "isr": (0xC, "rw"), "gain": (0x10, "rw"),
        "where_r_0": (0x18, "rw"), "where_r_1": (0x1C, "rw"), "sum": (0x24, "ro"), "sum_ctrl": (0x28, "ro"),
    }  # fmt: skip
    control = {name: (one.lsb, one.access, one.doc) for name, one in found["ap_ctrl"].fields.items()}
    assert control["start"] == (0, FieldAccess.W1S, "cleared by the handshake")
    assert control["done"] == (1, FieldAccess.RC, "reading clears it")
    assert control["idle"] == (2, FieldAccess.RO, "")
    assert control["auto_restart"] == (7, None, "")
    assert {one.access for one in found["isr"].fields.values()} == {FieldAccess.W1T}
    assert {one.access for one in found["ier"].fields.values()} == {None}
    assert {name: set(found[name].fields) for name in ("gie", "ier", "isr")} == {
        "gie": {"enable"}, "ier": {"done", "ready"}, "isr": {"done", "ready"},
    }  # fmt: skip
    assert "writing 1 toggles it" in found["isr"].doc + found["isr"].fields["done"].doc
    assert [name for name, one in found.items() if one.volatile] == ["ap_ctrl", "isr", "sum", "sum_ctrl"]


@pytest.mark.parametrize(
    ("said", "memory"),
    [
        ("(16 * 32b)", (0x40, 64, "uint32", (16,))),
        ("(64 * 8b)", (0x40, 64, "uint8", (64,))),
        ("(32 * 12b)", (0x40, 64, "uint16", (32,))),
        ("(3 * 16b)", (0x40, 8, "uint16", None)),
        ("(8 * 64b)", (0x40, 64, "uint64", (8,))),
    ],
)
def test_arrays_of_hls_are_memories(said: str, memory: tuple[object, ...], tmp_path: Path) -> None:
    path = tmp_path / "filter_control_s_axi.v"
    path.write_text(S_AXI["2024"].replace("(16 * 32b)", said))
    (found,) = read_register_map(path, "filter").memories.values()
    assert (found.name, (found.offset, found.size, found.dtype, found.shape)) == ("table", memory)


def test_addresses_of_hls_alone_are_enough(tmp_path: Path) -> None:
    path = tmp_path / "filter_control_s_axi.v"
    path.write_text("localparam" + S_AXI["2019"].split("localparam")[1])
    found = read_register_map(path, "filter")[0]
    assert (found["gain"].offset, found["where_r_1"].offset, found["sum"].offset) == (0x10, 0x1C, 0x24)
    assert "table" not in found


def test_a_comment_and_constants_that_disagree_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "filter_control_s_axi.v"
    path.write_text(S_AXI["2019"].replace("ADDR_GAIN_DATA_0   = 7'h10", "ADDR_GAIN_DATA_0   = 7'h14"))
    with pytest.raises(BuildError, match="gain is at 0x10 in the comment, at 0x14 in the constants"):
        read_register_map(path, "filter")


def test_systemrdl(tmp_path: Path) -> None:
    pytest.importorskip("systemrdl", reason="needs systemrdl-compiler: the extra [build] is not installed")
    (tmp_path / "filter.rdl").write_text(RDL)
    found = read_register_map(tmp_path / "filter.rdl", "filter")[0]
    assert (found["gain"].offset, found["gain"].access, found["gain"].reset) == (4, Access.RW, 0x10)
    state = found["state"]
    assert (state.access, state.fields["error"].lsb, state.reset, state.volatile) == (Access.RW, 4, None, True)
    assert {name: field.access for name, field in state.fields.items()} == {
        "busy": FieldAccess.RO,
        "error": FieldAccess.W1C,
    }


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.txt", "", "registers are read from"),
        ("a_s_axi.v", "module a_s_axi; endmodule", "describes no registers"),
        ("a.xml", "<spirit", "not XML"),
        ("a.xml", '<?xml version="1.0" encoding="aTF-8"?><a/>', "not XML"),
        ("a.xml", "<a/>", "describes no registers"),
        ("a.rdl", "addrmap {", r"^/.*/a\.rdl:1:\d+: error: "),
    ],
)
def test_what_cannot_be_read_is_reported(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(BuildError, match=words):
        read_register_map(tmp_path / name, "any")


def test_a_map_reaches_the_runtime_schema_and_the_build_schema_goes_first(tmp_path: Path) -> None:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    from build_support import AXIL_MODULE

    from cm import schema
    from cm.design.generate.generation import generate, load_design

    (tmp_path / "xone_hw.h").write_text(HLS)
    text = MINIMAL + "    register_map: xone_hw.h\n    registers: {gain: {offset: 0x10, default: 3, max: 9}}\n"
    built = load_design(project(tmp_path, text, one=AXIL_MODULE))
    generate(built, tmp_path / "build")
    registers = schema.load(tmp_path / "build/config/small.yaml").modules["one"].registers
    assert (registers["gain"].default, registers["gain"].maximum) == (3, 9)
    assert registers["sum"].offset == 0x18


def test_what_hls_wrote_needs_no_line_for_its_registers_and_two_sources_are_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    from build_support import AXIL_MODULE

    from cm import schema
    from cm.cli.main import main

    files = [tmp_path / "one.v", tmp_path / "one_control_s_axi.v"]
    files[0].write_text(AXIL_MODULE.replace("endmodule", "    one_control_s_axi inner ();\nendmodule"))
    files[1].write_text(S_AXI["2019"].replace("//----", "module one_control_s_axi;\n//----", 1) + "endmodule\n")
    build = tmp_path / "build.yaml"
    assert main(["build", "init", *map(str, files), "-o", str(build)]) == 0
    assert "register_map: one_control_s_axi.v" in build.read_text()
    assert main(["build", "generate", str(build)]) == 0
    path = next((tmp_path / "build/config").glob("*.yaml"))
    module = schema.load(path).modules["one"]
    registers, table = module.registers, module.memories["table"]
    assert (table.base_address, table.offset, table.size) == (registers["gain"].base_address, 0x40, 64)
    assert registers["ap_ctrl"].fields["auto_restart"].lsb == 7
    assert registers["where_r_1"].offset == 0x1C
    (tmp_path / "xone_hw.h").write_text(HLS.replace("0x10", "0x20"))
    build.write_text(build.read_text().replace("register_map: one_control_s_axi.v", "register_map: xone_hw.h"))
    capsys.readouterr()
    assert main(["build", "check", str(build)]) == 1
    assert "disagree: gain is at 0x20 and at 0x10; sum is at 0x18 and at 0x24" in capsys.readouterr().err


POINTERS = """// 0x10 : Data signal of src
//        bit 31~0 - src[31:0] (Read/Write)
// 0x14 : Data signal of src
//        bit 31~0 - src[63:32] (Read/Write)
// 0x40 ~
// 0x7f : Memory 'curve' (16 * 32b)
"""


@pytest.fixture
def kernel(tmp_path: Path) -> Path:
    """A build schema of a kernel that has its pointers on a bus of their own, as of Vitis HLS, and a third bus."""
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    from verilog_ports import AXI_LITE

    from cm.cli.main import main

    buses = ",\n".join(AXI_LITE.replace("s_axi_", f"s_axi_{bus}_") for bus in ("a_r", "control", "raw"))
    inner = "one_a_r_s_axi a ();\none_control_s_axi b ();\n"
    (tmp_path / "one.v").write_text(f"module one (input wire clk, input wire resetn,\n{buses});\n{inner}endmodule\n")
    for bus, said in (("control", S_AXI["2019"]), ("a_r", POINTERS)):
        (tmp_path / f"one_{bus}_s_axi.v").write_text(f"module one_{bus}_s_axi;\n{said}endmodule\n")
    build = tmp_path / "build.yaml"
    assert main(["build", "init", *map(str, sorted(tmp_path.glob("*.v"))), "-o", str(build)]) == 0
    return build


MAPS = "      s_axi_control: one_control_s_axi.v\n      s_axi_a_r: one_a_r_s_axi.v\n"  # what starts it is first


def test_each_register_bus_of_a_kernel_has_its_registers_by_name(kernel: Path, capsys: pytest.CaptureFixture) -> None:
    from cm import schema
    from cm.cli.main import main

    text = kernel.read_text()
    assert f"    register_map:\n{MAPS}" in text
    capsys.readouterr()
    assert main(["build", "check", str(kernel)]) == 0
    said = "its window is the memory one_s_axi_raw (register_map: {s_axi_raw: FILE}, beside that of the other"
    assert said in capsys.readouterr().out
    text = text.replace(MAPS, f"{MAPS}    registers: {{own: {{offset: 0x90}}}}\n")
    kernel.write_text(f"{text}\nmodes: {{default: {{modules: {{prr0: one}}, registers: {{src_0: 7, own: 8}}}}}}\n")
    assert main(["build", "generate", str(kernel)]) == 0
    config = schema.load(next((kernel.parent / "build/config").glob("*.yaml")))
    module, mode = config.modules["one"], config.modes["default"]
    base, pointers = module.registers["ap_ctrl"].base_address, module.registers["src_1"].base_address
    assert (module.registers["gain"].base_address, module.registers["own"].base_address) == (base, base)
    assert (module.memories["table"].base_address, module.memories["curve"].base_address) == (base, pointers)
    assert (mode.registers["src_0"].base_address, mode.registers["own"].base_address) == (pointers, base)
    raw = module.memories["one_s_axi_raw"]
    assert len({base, pointers, raw.base_address}) == 3
    assert raw.size == 256  # of its 8 address bits; its window is larger


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("s_axi_a_r: one", "s_axi_a: one", "register_map.s_axi_a: region prr0 has no register interface 's_axi_a'"),
        ("one_a_r_s_axi.v", "missing.v", "register_map.s_axi_a_r: missing.v does not exist"),
        ("one_a_r_s_axi.v", "one.v", "one.v: registers are read from .xml"),
        ("s_axi_a_r: one_a_r", "s_axi_raw: one_control", "where_r_1 are names on s_axi_control too"),
    ],
)
def test_what_is_wrong_with_the_register_map_of_a_bus_is_said_with_its_place(
    kernel: Path, capsys: pytest.CaptureFixture, old: str, new: str, said: str
) -> None:
    from cm.cli.main import main

    assert old in kernel.read_text()
    kernel.write_text(kernel.read_text().replace(old, new))
    capsys.readouterr()
    assert main(["build", "check", str(kernel)]) != 0
    assert said in capsys.readouterr().err


CONFIG_JSON = """{"scale": {"S_AXI_CONTROL": {
  "rows": {"name": "rows", "offset": "0x10", "size": "0x4", "type": "unsigned short"},
  "start at": {"name": "start at", "offset": "0x18", "size": "0x8", "type": "unsigned long"}}}}"""


def test_arguments_are_read_from_the_config_json_of_hls(tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(CONFIG_JSON)
    found = read_register_map(tmp_path / "config.json", "scale")[0]
    assert {name: spec.offset for name, spec in found.items()} == {"rows": 0x10, "start_at_0": 0x18, "start_at_1": 0x1C}


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"a": {"b": {"c": {"name": "c"}}}}', '{"a": 1}', '{"a": {}, "b": {}}']
)
def test_another_json_is_no_register_map(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(BuildError, match=r"config\.json: not a config\.json of HLS"):
        read_register_map(tmp_path / "config.json", "scale")
