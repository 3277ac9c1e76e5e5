# SPDX-License-Identifier: Apache-2.0
"""Registers read from other tools' descriptions."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import MINIMAL, project
from import_support import described, hwh, module, register, register_field

from cm.design.errors import BuildError
from cm.design.hdl.register_maps import read_register_map
from cm.schema.model import Access

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

RDL = """\
addrmap filter {
    reg { field { sw = rw; hw = r; } value[7:0] = 8'h10; } gain @ 0x4;
    reg { field { sw = r; hw = w; } busy; field { sw = rw; onwrite = woclr; hw = w; } error[5:4]; } state @ 0x8;
};
"""


def test_ip_xact(tmp_path: Path) -> None:
    (tmp_path / "component.xml").write_text(IPXACT)
    found = read_register_map(tmp_path / "component.xml", "any")["status_word"]
    assert (found.offset, found.width, found.access, found.reset) == (0x108, 32, Access.RO, 5)
    assert (found.fields["done"].lsb, found.fields["done"].width) == (3, 2)
    assert found.doc == "What happened"


def test_hardware_handoff(tmp_path: Path) -> None:
    text = hwh(module("f0", "filter", described(register("GAIN", 8, register_field("LOW", 0, 4), size=8))))
    (tmp_path / "a.hwh").write_bytes(text)
    found = read_register_map(tmp_path / "a.hwh", "filter")["gain"]
    assert (found.offset, found.width, found.fields["low"].width) == (8, 32, 4)


def test_hls_header(tmp_path: Path) -> None:
    (tmp_path / "xfilter_hw.h").write_text(HLS)
    found = read_register_map(tmp_path / "xfilter_hw.h", "filter")
    assert {name: (one.offset, one.access) for name, one in found.items()} == {
        "ap_ctrl": (0, Access.RW),
        "gain": (0x10, Access.RW),
        "sum": (0x18, Access.RO),
    }


def test_systemrdl(tmp_path: Path) -> None:
    pytest.importorskip("systemrdl", reason="needs systemrdl-compiler: the extra [build] is not installed")
    (tmp_path / "filter.rdl").write_text(RDL)
    found = read_register_map(tmp_path / "filter.rdl", "filter")
    assert (found["gain"].offset, found["gain"].access, found["gain"].reset) == (4, Access.RW, 0x10)
    assert (found["state"].access, found["state"].fields["error"].lsb) == (Access.W1C, 4)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.txt", "", "registers are read from"),
        ("a.xml", "<spirit", "not XML"),
        ("a.xml", '<?xml version="1.0" encoding="aTF-8"?><a/>', "not XML"),
        ("a.xml", "<a/>", "describes no registers"),
        ("a.rdl", "addrmap {", "a.rdl"),
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
    from cm.design.generate.tree import generate, load_design

    (tmp_path / "xone_hw.h").write_text(HLS)
    text = MINIMAL + "    register_map: xone_hw.h\n    registers: {gain: {offset: 0x10, default: 3, max: 9}}\n"
    built = load_design(project(tmp_path, text, one=AXIL_MODULE))
    generate(built, tmp_path / "build")
    registers = schema.load(tmp_path / "build/config/small.yaml").modules["one"].registers
    assert (registers["gain"].default, registers["gain"].maximum) == (3, 9)
    assert registers["sum"].offset == 0x18
