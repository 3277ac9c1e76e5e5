# SPDX-License-Identifier: Apache-2.0
"""What descriptions of registers say beside names and addresses: arrays, accesses of fields, resets, memories."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from import_support import described, hwh, module, register, register_field

from cm.design.errors import BuildError
from cm.design.hdl.register_maps import RegisterMap, read_register_map

NAMESPACES = {
    "2009": "http://www.spiritconsortium.org/XMLSchema/SPIRIT/1685-2009",
    "2014": "http://www.accellera.org/XMLSchema/IPXACT/1685-2014",
    "2022": "http://www.accellera.org/XMLSchema/IPXACT/1685-2022",
}


def ipxact(
    folder: Path, year: str, body: str, block: str = "<baseAddress>0x100</baseAddress><range>0x100</range>"
) -> RegisterMap:
    path = folder / "component.xml"
    path.write_text(
        f'<component xmlns="{NAMESPACES[year]}"><memoryMaps><memoryMap><name>m</name><addressBlock><name>b</name>'
        f"{block}{body}</addressBlock></memoryMap></memoryMaps></component>"
    )
    return read_register_map(path, "any")


def described_register(name: str, offset: int, *parts: str, size: int = 32) -> str:
    more = "".join(parts)
    return f"<register><name>{name}</name><addressOffset>{offset}</addressOffset><size>{size}</size>{more}</register>"


def described_field(name: str, lsb: int, width: int, *parts: str) -> str:
    more = "".join(parts)
    return f"<field><name>{name}</name><bitOffset>{lsb}</bitOffset><bitWidth>{width}</bitWidth>{more}</field>"


def places(found: RegisterMap) -> dict[str, int]:
    return {name: spec.offset for name, spec in found.registers.items()}


def accesses(found: RegisterMap, name: str) -> dict[str, str]:
    spec = found.registers[name]
    return {field.name: spec.access_of(field).value for field in spec.fields.values()}


def test_arrays_and_register_files_of_ip_xact_are_unrolled(tmp_path: Path) -> None:
    array = described_register("tap", 0, "<dim>2</dim>")
    files = (
        "<registerFile><name>ch</name><dim>2</dim><addressOffset>0x10</addressOffset><range>0x8</range>"
        f"{described_register('gain', 0)}{described_register('level', 4)}</registerFile>"
    )
    assert places(ipxact(tmp_path, "2009", array + files)) == {
        "tap_0": 0x100, "tap_1": 0x104,
        "ch_0_gain": 0x110, "ch_0_level": 0x114, "ch_1_gain": 0x118, "ch_1_level": 0x11C,
    }  # fmt: skip


def test_a_stride_of_2022_is_kept(tmp_path: Path) -> None:
    array = described_register("tap", 0, "<array><dim>3</dim><stride>8</stride></array>")
    assert places(ipxact(tmp_path, "2022", array)) == {"tap_0": 0x100, "tap_1": 0x108, "tap_2": 0x110}


def test_a_field_of_ip_xact_has_its_own_access_and_reset(tmp_path: Path) -> None:
    fields = (
        described_field("gain", 0, 4, "<resets><reset><value>0x5</value></reset></resets>"),
        described_field("mode", 4, 4, "<resets><reset><value>'h3</value></reset></resets>"),
        described_field(
            "seen", 8, 1, "<access>read-write</access><modifiedWriteValue>oneToClear</modifiedWriteValue>"
            "<resets><reset><value>0</value></reset></resets>",
        ),
    )  # fmt: skip
    found = ipxact(tmp_path, "2014", described_register("status", 0, *fields))
    assert accesses(found, "status") == {"gain": "rw", "mode": "rw", "seen": "w1c"}
    assert (found.registers["status"].access.value, found.registers["status"].reset) == ("rw", 0x35)


def test_policies_and_enumerations_of_2022_are_read(tmp_path: Path) -> None:
    policy = (
        "<fieldAccessPolicies><fieldAccessPolicy><access>read-only</access><readAction>clear</readAction>"
        "</fieldAccessPolicy></fieldAccessPolicies><enumeratedValues><enumeratedValue><name>Busy</name><value>1</value>"
        "</enumeratedValue></enumeratedValues>"
    )
    found = ipxact(tmp_path, "2022", described_register("state", 0, described_field("done", 0, 1, policy)))
    assert accesses(found, "state") == {"done": "rc"}
    assert dict(found.registers["state"].fields["done"].values) == {"busy": 1}


@pytest.mark.parametrize("size", [1, 7, 16, 32])
def test_a_register_alone_in_its_word_is_accessed_by_a_word(size: int, tmp_path: Path) -> None:
    assert ipxact(tmp_path, "2009", described_register("few", 0, size=size)).registers["few"].width == 32


def test_registers_of_16_bits_in_one_word_are_two(tmp_path: Path) -> None:
    pair = described_register("low", 0x10, size=16) + described_register("high", 0x12, size=16)
    found = ipxact(tmp_path, "2009", pair).registers
    assert [(spec.name, spec.offset, spec.width) for spec in found.values()] == [
        ("low", 0x110, 16),
        ("high", 0x112, 16),
    ]


def test_a_block_that_is_a_memory_is_one(tmp_path: Path) -> None:
    block = "<baseAddress>0x1000</baseAddress><range>0x400</range><width>32</width><usage>memory</usage>"
    (found,) = ipxact(tmp_path, "2009", "", block).memories.values()
    assert (found.name, found.offset, found.size) == ("b", 0x1000, 0x400)


def test_what_ip_xact_describes_elsewhere_is_named(tmp_path: Path) -> None:
    other = "<alternateRegisters><alternateRegister><name>debug</name></alternateRegister></alternateRegisters>"
    found = ipxact(tmp_path, "2014", described_register("status", 0, other))
    assert found.notes == ["status: another view of a register, left out"]


def rdl(folder: Path, body: str) -> RegisterMap:
    pytest.importorskip("systemrdl", reason="needs systemrdl-compiler: the extra [build] is not installed")
    (folder / "m.rdl").write_text(f"addrmap m {{ {body} }};")
    return read_register_map(folder / "m.rdl", "m")


RDL_FIELDS = {
    "sw=rw; hw=r;": "rw",
    "sw=r; hw=w;": "ro",
    "sw=w; hw=r;": "wo",
    "sw=rw; hw=w; woset;": "w1s",
    "sw=rw; hw=w; woclr;": "w1c",
    "sw=rw; hw=w; onwrite=wot;": "w1t",
    "sw=rw; hw=w; onwrite=wzc;": "w0c",
    "sw=rw; hw=w; onwrite=wclr;": "wc",
    "sw=r; hw=w; rclr;": "rc",
    "sw=r; hw=w; rset;": "rs",
    "sw=rw; hw=w; rclr;": "wrc",
    "sw=rw; hw=r; singlepulse;": "w1s",
}


@pytest.mark.parametrize("said", RDL_FIELDS)
def test_a_field_of_systemrdl_has_its_own_access(said: str, tmp_path: Path) -> None:
    found = rdl(tmp_path, f"reg {{ field {{ {said} }} one[0:0] = 0; field {{ sw=rw; hw=r; }} gain[15:8] = 0; }} reg0;")
    assert accesses(found, "reg0") == {"one": RDL_FIELDS[said], "gain": "rw"}


def test_a_wide_register_of_systemrdl_is_as_many_as_it_takes_accesses(tmp_path: Path) -> None:
    wide = "reg { regwidth = 64; accesswidth = 32; field { sw=rw; hw=r; } value[63:0] = 64'h1_0000_0002; } time @ 0xC;"
    found = rdl(tmp_path, wide).registers
    assert {name: (spec.offset, spec.width, spec.reset) for name, spec in found.items()} == {
        "time_0": (0xC, 32, None), "time_1": (0x10, 32, None),
    }  # fmt: skip


def test_names_that_differ_in_case_only_are_kept_apart(tmp_path: Path) -> None:
    body = "reg { field { sw=rw; hw=r; } a[7:0] = 1; field { sw=rw; hw=r; } A[15:8] = 2; }"
    found = rdl(tmp_path, f"{body} upper @ 0; {body} Upper @ 4;")
    assert places(found) == {"upper": 0, "upper_2": 4}
    assert (list(found.registers["upper"].fields), found.registers["upper"].reset) == (["a", "a_2"], 0x201)


def test_memories_enumerations_and_unknown_resets_of_systemrdl(tmp_path: Path) -> None:
    found = rdl(
        tmp_path,
        "enum speed { slow = 0; fast = 2; }; external mem { mementries = 64; memwidth = 16; } table @ 0x100;"
        "reg { field { sw=rw; hw=r; encode = speed; } s[1:0] = 2; field { sw=r; hw=w; } now[15:8]; } reg0 @ 0;",
    )
    table, spec = found.memories["table"], found.registers["reg0"]
    assert (table.offset, table.size, table.dtype) == (0x100, 128, "uint16")
    assert (dict(spec.fields["s"].values), spec.reset, spec.volatile) == ({"slow": 0, "fast": 2}, None, True)


def handoff(folder: Path, *registers: str) -> RegisterMap:
    (folder / "a.hwh").write_bytes(hwh(module("f0", "filter", described(*registers))))
    return read_register_map(folder / "a.hwh", "filter")


def test_the_handoff_of_a_kernel_says_what_its_bits_do(tmp_path: Path) -> None:
    """As Vivado 2018 to 2024 writes it: the modified *write* values are called read values, and most are `modify`."""
    plain: Any = {"MODIFIED_READ_VALUES": "modify", "READ_ACTION": ""}
    only: Any = {"access": "read-only", "MODIFIED_READ_VALUES": "", "READ_ACTION": "modify"}
    toggled: Any = {"access": "read-only", "MODIFIED_READ_VALUES": "oneToToggle", "READ_ACTION": "modify"}
    found = handoff(
        tmp_path,
        register("CTRL", 0, register_field("AP_START", 0, 1, **plain), register_field("AP_DONE", 1, 1, **only),
                 register_field("AP_IDLE", 2, 1, **only), register_field("AUTO_RESTART", 7, 1, **plain),
                 RESET_VALUE="0"),
        register("IP_ISR", 12, register_field("CHAN0_INT_ST", 0, 1, **toggled)),
        register("Memory_table", 0x40, size=9), register("n", 0x80),
    )  # fmt: skip
    assert accesses(found, "ctrl") == {"ap_start": "w1s", "ap_done": "rc", "ap_idle": "ro", "auto_restart": "rw"}
    assert accesses(found, "ip_isr") == {"chan0_int_st": "w1t"}
    assert (found.memories["table"].offset, found.memories["table"].size) == (0x40, 0x40)


def test_words_of_16_bits_in_a_handoff_are_no_aliases(tmp_path: Path) -> None:
    found = handoff(tmp_path, register("low", 0x10, size=16), register("high", 0x12, size=16))
    assert places(found) == {"low": 0x10, "high": 0x12}


def test_what_a_register_map_cannot_carry_is_said_by_check(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("systemrdl", reason="needs systemrdl-compiler: the extra [build] is not installed")
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    from build_support import AXIL_MODULE, MINIMAL, project

    from cm.cli.main import main

    twice = "field { sw=rw; hw=r; onread=ruser; } gain[15:8] = 0;"
    path = project(tmp_path, f"{MINIMAL}    register_map: one.rdl\n", one=AXIL_MODULE)
    (tmp_path / "one.rdl").write_text(f"addrmap one {{ external reg {{ {twice} }} reg0; }};")
    main(["build", "check", str(path)])
    assert "one.rdl: an access changes it, nobody says how: reg0.gain" in capsys.readouterr().out


LITEX = """{"csr_bases": {"ctrl": 4026531840, "timer": 4026533888},
 "memories": {"csr": {"base": 4026531840, "size": 65536, "type": "io"}},
 "constants": {"config_csr_data_width": 32, "config_csr_alignment": 32},
 "csr_registers": {"ctrl_reset": {"addr": 4026531840, "size": 1, "type": "rw"},
  "timer_load": {"addr": 4026533888, "size": 1, "type": "rw"},
  "timer_uptime": {"addr": 4026533892, "size": 2, "type": "ro"}}}"""


def test_the_csr_json_of_litex_has_the_highest_word_first(tmp_path: Path) -> None:
    """As `get_csr_json` of LiteX 2023 to 2025 writes it."""
    (tmp_path / "csr.json").write_text(LITEX)
    found = read_register_map(tmp_path / "csr.json", "timer")
    assert places(found) == {"load": 0, "uptime_1": 4, "uptime_0": 8}
    assert found.registers["uptime_0"].access.value == "ro"
    assert found.notes == [
        "timer_uptime: 2 words, the highest first, as LiteX' own accessors have it whatever its order"
    ]
    assert places(read_register_map(tmp_path / "csr.json", "soc"))["timer_load"] == 0x800


@pytest.mark.parametrize("standard", ["IEEE_1685_2009", "IEEE_1685_2014"])
def test_what_peakrdl_exports_as_ip_xact_is_read_as_the_systemrdl_itself(standard: str, tmp_path: Path) -> None:
    exporter = pytest.importorskip("peakrdl_ipxact", reason="needs peakrdl-ipxact: the extra [test-design]")
    from systemrdl import RDLCompiler

    (tmp_path / "m.rdl").write_text(
        "addrmap m { reg { field { sw=rw; hw=r; } gain[7:0] = 16; field { sw=rw; hw=w; woclr; } seen[8:8] = 0;"
        " field { sw=r; hw=w; rclr; } done[9:9] = 0; } status @ 0; reg { field { sw=rw; hw=r; } v[31:0] = 0; } tap[3];"
        " regfile { reg { field { sw=rw; hw=r; } g[7:0] = 1; } a; reg { field { sw=w; hw=r; } g[7:0] = 2; } b;"
        " } ch[2];"
        " reg { regwidth=64; accesswidth=32; default sw=rw; default hw=r;"
        " field {} low[31:0] = 1; field {} high[63:32] = 2; } wide @ 0x24; };"
    )
    compiler = RDLCompiler()
    compiler.compile_file(str(tmp_path / "m.rdl"))
    path = tmp_path / "m.xml"
    exporter.IPXACTExporter(standard=exporter.Standard[standard]).export(compiler.elaborate(), str(path))

    def told(found: RegisterMap) -> dict[str, Any]:
        return {
            name: (spec.offset, spec.width, spec.access, spec.reset, accesses(found, name))
            for name, spec in found.registers.items()
        }

    assert told(read_register_map(path, "m")) == told(read_register_map(tmp_path / "m.rdl", "m"))


AXION = """{"module": "filter", "base_addr": "0x0000", "config": {"cdc_en": false, "cdc_stage": 2}, "registers": [
 {"name": "status", "addr": "0x00", "access": "RO", "width": 32, "description": "What it does"},
 {"name": "total", "addr": "0x08", "access": "RO", "width": 64},
 {"name": "control", "addr": "0x04", "access": "RW", "width": 32, "fields": [
  {"name": "mode", "bit_offset": 0, "width": 2, "access": "RW", "default": "0x2",
   "enum_values": {"0": "OFF", "2": "ON"}},
  {"name": "go", "bit_offset": 8, "width": 1, "access": "WO"}]}]}"""


def test_the_json_of_axion_hdl_is_read(tmp_path: Path) -> None:
    """As `generate_json` of axion-hdl 1.7 writes it."""
    (tmp_path / "filter.json").write_text(AXION)
    found = read_register_map(tmp_path / "filter.json", "filter")
    assert places(found) == {"status": 0, "total_0": 8, "total_1": 12, "control": 4}
    assert (accesses(found, "control"), found.registers["control"].reset) == ({"mode": "rw", "go": "wo"}, 2)
    assert dict(found.registers["control"].fields["mode"].values) == {"off": 0, "on": 2}
    assert found.registers["status"].access.value == "ro"


BUST = """{"bus": {"type": "axi", "addr_width": 32, "data_width": 32}, "module": {"name": "filter", "register": [
 {"name": "seen", "type": "bit", "sw": "rw", "hw": "w", "onwrite": "woclr"},
 {"name": "control", "address": "0x10", "type": "fields", "fields": [
  {"name": "mode", "type": "vector", "width": 2, "reset": 2, "enums": [{"name": "on", "value": 2}]},
  {"name": "go", "type": "bit", "singlepulse": true}]},
 {"name": "level", "hw": "w", "sw": "r", "onread": "rclr"}]}}"""


def test_the_json_of_bust_is_read(tmp_path: Path) -> None:
    (tmp_path / "filter.json").write_text(BUST)
    found = read_register_map(tmp_path / "filter.json", "filter")
    assert places(found) == {"seen": 0, "control": 0x10, "level": 4}
    assert (accesses(found, "control"), found.registers["control"].reset) == ({"mode": "rw", "go": "w1s"}, 2)
    assert (accesses(found, "level"), accesses(found, "seen")) == ({"level": "rc"}, {"seen": "w1c"})


@pytest.mark.parametrize("width", ["null", "99999999999999999999", "NaN"])
def test_a_width_that_no_register_has_is_refused(width: str, tmp_path: Path) -> None:
    said = '{"csr_registers": {"a": {"addr": 0, "size": 2, "type": "rw"}}, "csr_bases": {},'
    (tmp_path / "csr.json").write_text(f'{said} "constants": {{"config_csr_data_width": {width}}}, "memories": {{}}}}')
    with pytest.raises(BuildError, match=r"csr\.json: "):
        read_register_map(tmp_path / "csr.json", "")
