# SPDX-License-Identifier: Apache-2.0
"""Interfaces of Verilog and SystemVerilog modules."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyslang")

from hdl_support import DATA, extract, lite, module, ports, stream

from cm.design.hdl.errors import HdlError, ParserMissing
from cm.design.hdl.extract import Sources, read
from cm.design.hdl.model import FoundBy, Language, Mode, Polarity, PortDirection
from cm.design.hdl.verilog import VerilogReader
from cm.design.input_kinds import read_inputs


def test_a_nettype_that_a_file_leaves_behind_counts_for_those_after_it(tmp_path: Path) -> None:
    """As olofk of chipsalliance/VeeRwolf 2 explains Synth 8-6735."""
    (tmp_path / "a.v").write_text("`default_nettype none\nmodule a (input wire x);\nendmodule\n")
    (tmp_path / "b.v").write_text("module b (input x, output wire y);\n assign y = x;\nendmodule\n")
    (found,) = read(Sources([tmp_path / "a.v", tmp_path / "b.v"], top="b")).modules
    assert [problem.message[-14:] for problem in found.problems] == ["[Synth 8-6735]"]
    assert [(p.file, p.line, p.breaks) for p in found.problems] == [(str(tmp_path / "b.v"), 1, True)]
    (tmp_path / "a.v").write_text("`default_nettype none\nmodule a (input wire x);\nendmodule\n`default_nettype wire\n")
    (found,) = read(Sources([tmp_path / "a.v", tmp_path / "b.v"], top="b")).modules
    assert found.problems == ()


def test_module_with_registers_streams_and_an_interrupt_is_read_completely() -> None:
    (camera,) = extract([DATA / "camera_edge.v"], top="camera_edge", include_dirs=[DATA / "include"])
    found = [(i.name, i.protocol, i.mode, i.clock, i.reset, len(i.ports)) for i in camera.interfaces]
    assert found == [
        ("s_axi", "axi4lite", Mode.SLAVE, "aclk", "aresetn", 19),
        ("s_axis", "axis", Mode.SLAVE, "aclk", "aresetn", 6),
        ("m_axis", "axis", Mode.MASTER, "aclk", "aresetn", 6),
    ]
    assert camera.interface("s_axi").ports["AWADDR"] == "s_axi_awaddr"
    assert camera.interface("s_axi").reset_polarity is Polarity.LOW
    assert [(i.port, i.sensitivity) for i in camera.interrupts] == [("irq_frame_done", "")]
    assert [left.port for left in camera.leftovers] == ["status_leds"]
    assert camera.instantiates == ("camera_edge_kernel",)
    assert camera.problems == ()


def test_widths_follow_parameters_macros_and_localparams() -> None:
    (camera,) = extract(
        [DATA / "camera_edge.v"],
        top="camera_edge",
        include_dirs=[DATA / "include"],
        defines={"REGISTER_BITS": "9"},
        parameters={"DATA_WIDTH": "64"},
    )
    assert camera.interface("s_axi").addr_width == 9
    assert camera.interface("s_axis").data_width == 64
    assert camera.port("s_axis_tkeep").width == 8
    assert {p.name: (p.value, p.local) for p in camera.parameters}["DATA_WIDTH"] == (64, False)


def test_port_tells_range_type_line_and_direction() -> None:
    (camera,) = extract([DATA / "camera_edge.v"], top="camera_edge", include_dirs=[DATA / "include"])
    port = camera.port("s_axis_tdata")
    assert (port.range, port.direction, port.line) == ("[DATA_WIDTH-1:0]", PortDirection.IN, 34)
    assert port.file.endswith("camera_edge.v")


def test_attributes_take_precedence_over_names_in_any_case_and_on_non_ansi_ports() -> None:
    (tagged,) = extract([DATA / "tagged.v"])
    assert dict(tagged.interface("pixels_in").ports) == {"TDATA": "d", "TVALID": "dv", "TREADY": "dr"}
    assert tagged.interface("pixels_out").mode is Mode.MASTER
    assert tagged.interface("pixels_out").found_by is FoundBy.ATTRIBUTE
    assert tagged.interface("pixels_in").clock == "ck"
    assert (tagged.clocks[0].frequency_hz, tagged.clocks[0].reset) == (100_000_000, "nclr")
    assert tagged.resets[0].polarity is Polarity.LOW
    assert (tagged.interrupts[0].port, tagged.interrupts[0].sensitivity) == ("ev", "EDGE_RISING")


def test_ports_marked_ignore_are_left_over_with_the_reason() -> None:
    (tagged,) = extract([DATA / "tagged.v"])
    assert {left.port: left.reason for left in tagged.leftovers} == {
        "spare_tdata": "is marked X_INTERFACE_IGNORE",
        "spare_tvalid": "is marked X_INTERFACE_IGNORE",
    }


def test_monitor_is_one_only_where_the_attribute_says_so() -> None:
    (tagged,) = extract([DATA / "tagged.v"])
    assert tagged.interface("probe").mode is Mode.MONITOR


def test_attribute_on_some_ports_is_completed_by_the_names_of_the_others(tmp_path: Path) -> None:
    info = '(* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 video TVALID" *)'
    text = f"input [7:0] s_axis_tdata; {info} input s_axis_tvalid; output s_axis_tready; input s_axis_tlast; input clk"
    (video,) = ports(tmp_path, text).interfaces
    assert (video.name, set(video.ports)) == ("video", {"TDATA", "TVALID", "TREADY", "TLAST"})


@pytest.mark.parametrize(
    ("bus", "port", "mode"),
    [
        *((bus, "input a", Mode.MASTER) for bus in ("M_thing", "master_0", "source", "initiator_x")),
        *((bus, "output a", Mode.SLAVE) for bus in ("s_thing", "Slave_0", "sink", "target_x")),
        ("thing_m", "input a", Mode.SLAVE),
        ("thing_s", "output a", Mode.MASTER),
    ],
)
def test_the_mode_of_an_unknown_protocol_is_guessed_by_name_then_by_direction(
    bus: str, port: str, mode: Mode, tmp_path: Path
) -> None:
    info = f'(* X_INTERFACE_INFO = "acme.com:user:thing:1.0 {bus} A" *)'
    found = ports(tmp_path, f"{info} {port}; input clk")
    assert [(i.name, i.mode, i.protocol) for i in found.interfaces] == [(bus, mode, "thing")]
    (problem,) = found.problems
    assert f"the mode of {bus} (acme.com:user:thing:1.0) is a guess" in problem.message
    assert f": {mode.value}; state it with X_INTERFACE_MODE" in problem.message


def test_ports_of_the_other_direction_are_not_of_the_attributes_bus(tmp_path: Path) -> None:
    info = '(* X_INTERFACE_INFO = "xilinx.com:interface:axis:1.0 video TVALID" *)'
    text = f"output [7:0] s_axis_tdata; {info} input s_axis_tvalid; output s_axis_tready; input clk"
    assert [(i.name, set(i.ports)) for i in ports(tmp_path, text).interfaces] == [("video", {"TVALID"})]


def test_an_associated_reset_is_its_buses_whatever_others_are_called(tmp_path: Path) -> None:
    said = '(* X_INTERFACE_PARAMETER = "ASSOCIATED_RESET nothing:init_rst" *) input s_axis_aclk'
    found = ports(tmp_path, f"{stream('s_axis_', 'slave')}; {said}; input s_axis_aresetn; input init_rst")
    assert [(i.clock, i.reset, i.reset_polarity) for i in found.interfaces] == [
        ("s_axis_aclk", "init_rst", Polarity.HIGH)
    ]
    assert [(clock.reset, clock.resets) for clock in found.clocks] == [("init_rst", ("init_rst",))]


def test_malformed_attribute_is_reported_and_names_still_count(tmp_path: Path) -> None:
    text = '(* X_INTERFACE_INFO = "axis s TDATA" *) input [7:0] s_tdata; input s_tvalid; output s_tready; input clk'
    found = ports(tmp_path, text)
    assert [i.name for i in found.interfaces] == ["s"]
    assert any("X_INTERFACE_INFO is not" in str(problem) for problem in found.problems)


def test_modules_inside_generate_constructs_are_instantiated(tmp_path: Path) -> None:
    found = module(
        tmp_path,
        """
        module m #(parameter N = 1) (input clk);
          plain a (clk);
          generate
            if (N == 1) one b (clk); else if (N == 2) begin : two_ two c (clk); end else other d (clk);
            case (N) 1: first e (clk); default: rest f (clk); endcase
            for (genvar k = 0; k < N; k = k + 1) begin : each lane g (clk); end
          endgenerate
        endmodule
        """,
    )
    assert found.instantiates == ("plain", "one", "two", "other", "first", "rest", "lane")


@pytest.mark.parametrize("name", ["do", "bit", "final", "logic", "priority"])
def test_systemverilog_keywords_are_names_in_verilog_files(tmp_path: Path, name: str) -> None:
    found = ports(tmp_path, f"input {name}; output [3:0] q")
    assert (found.language, found.ports[0].name, found.problems) == (Language.VERILOG, name, ())


def test_systemverilog_in_a_verilog_file_is_read_as_such(tmp_path: Path) -> None:
    found = module(tmp_path, "module m (input logic [3:0] a); always_comb begin end endmodule")
    assert (found.language, found.port("a").width, found.problems) == (Language.SYSTEMVERILOG, 4, ())


def test_what_cannot_cross_a_boundary_needs_a_flat_wrapper() -> None:
    (unflat,) = extract([DATA / "unflat.sv"])
    assert {port.name for port in unflat.ports if not port.flat} == {"open", "lanes", "sample", "stream", "unknown"}
    assert [(p.name, p.value, p.local) for p in unflat.parameters] == [("sample_t", None, False), ("DEPTH", 4, False)]
    assert not unflat.usable
    assert all("needs a flat wrapper" in problem.message for problem in unflat.problems)
    assert unflat.port("pixel").width == 24  # a packed struct is a vector
    assert unflat.port("level").width == 2


def test_one_of_several_buses_is_a_bus_when_the_parameter_says_one(tmp_path: Path) -> None:
    text = "input clk; input [8*N-1:0] s_axis_tdata; input [N-1:0] s_axis_tvalid; output [N-1:0] s_axis_tready"
    assert len(ports(tmp_path, text, "parameter N = 4", parameters={"N": "1"}).interfaces) == 1


def test_port_that_is_named_like_a_signal_by_chance_is_just_left_over(tmp_path: Path) -> None:
    found = ports(tmp_path, "input tid; input [3:0] wid; output bvalid_count; input latched_wdata_x")
    assert found.interfaces == ()
    assert all("no bus" in left.reason for left in found.leftovers)
    assert found.problems == ()


@pytest.mark.parametrize(
    ("declarations", "name"),
    [
        (stream("s_axis_", "slave"), "s_axis"),
        (stream("S_AXIS_VIDEO_", "slave").replace("tdata", "TDATA"), "S_AXIS_VIDEO"),
        (stream("", "slave"), "s_axis"),
        ("input [7:0] tdata_0; input tvalid_0; output tready_0", "0"),
        ("input [7:0] i_s_tdata; input i_s_tvalid; output o_s_tready", "s"),
        ("input [7:0] s_tdata_i; input s_tvalid_i; output s_tready_o", "s"),
        ("input [7:0] i_axis_data; input i_axis_valid; output o_axis_ready", "axis"),
        ("input [7:0] videoTDATA; input videoTVALID; output videoTREADY", "video"),
    ],
)
def test_a_stream_is_recognised_by_many_habits_of_naming(tmp_path: Path, declarations: str, name: str) -> None:
    (found,) = ports(tmp_path, declarations + "; input clk").interfaces
    assert (found.name, found.protocol, found.mode, len(found.ports)) == (name, "axis", Mode.SLAVE, 3)


@pytest.mark.parametrize(
    ("extra", "protocol"),
    [("", "axi4lite"), ("input [7:0] s_awlen; input [7:0] s_arlen;", "axi4"), ("input [3:0] s_awlen;", "axi3")],
)
def test_axi_flavour_follows_the_burst_signals(tmp_path: Path, extra: str, protocol: str) -> None:
    assert ports(tmp_path, lite("s_") + extra + "input clk").interfaces[0].protocol == protocol


def test_read_only_master_is_a_bus(tmp_path: Path) -> None:
    half = lite("m_", "master")
    (found,) = ports(tmp_path, half[half.index("output [11:0] m_araddr") :] + "input clk").interfaces
    assert (found.reads, found.writes, found.mode) == (True, False, Mode.MASTER)


@pytest.mark.parametrize(
    ("clocks", "expected"),
    [
        ("input clk", ("clk", "clk")),
        ("input s_axis_aclk; input m_axis_aclk", ("s_axis_aclk", "m_axis_aclk")),
        ("input s_clk; input m_clk", ("s_clk", "m_clk")),
        ("input ap_clk; input ref_clk", ("ap_clk", "ap_clk")),
        ("input one_clk; input two_clk", (None, None)),
        ("input s_axis_aclk; input s_axis_video_aclk; input m_axis_aclk", ("s_axis_aclk", "m_axis_aclk")),
        ("input one_clk; output two_clk", (None, None)),
    ],
)
def test_a_clock_is_recognised_by_name_or_not_at_all(
    tmp_path: Path, clocks: str, expected: tuple[str | None, str | None]
) -> None:
    found = ports(tmp_path, stream("s_axis_", "slave") + stream("m_axis_", "master") + clocks)
    assert tuple(interface.clock for interface in found.interfaces) == expected
    assert bool(found.problems) == (expected[0] is None)


NAMES = {
    "clock": "clk aclk clk_i clk100m clk_50mhz pixelClk DMA_REQ_ACLK clkin1 CLOCK",
    "reset-low": "aresetn rst_n rst_ni nreset S_AXI_ARESETN reset_b",
    "reset-high": "rst areset i_reset",
    "interrupt": "irq o_int interrupt rx_intr ip2intc_irpt irq_0 int_o",
    "nothing": "clk_en clken aclken clkdiv clk_sel sclk clk_req reset_done rst_count preset irq_mask interior int_a",
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in NAMES.items() for name in names.split()])
def test_a_port_is_a_clock_a_reset_or_an_interrupt_by_its_name(tmp_path: Path, kind: str, name: str) -> None:
    found = ports(tmp_path, f"{'output' if kind == 'interrupt' else 'input'} {name}")
    told = [("clock", clock.port) for clock in found.clocks]
    told += [(f"reset-{reset.polarity.value}", reset.port) for reset in found.resets if reset.polarity]
    told += [("interrupt", interrupt.port) for interrupt in found.interrupts]
    told += [("nothing", left.port) for left in found.leftovers]
    assert told == [(kind, name)]


@pytest.mark.parametrize(
    ("declarations", "said"),
    [
        (
            "input clk; input [31:0] s_axis_tdata; input [3:0] s_axis_tvalid; output [3:0] s_axis_tready",
            "s_axis_tvalid has 4 bits: several buses side by side",
        ),
        ("input clk; input [7:0] mon_tdata; input mon_tvalid; input mon_tready", "directions are mixed"),
        (
            lite("s_axi_").replace("output s_axi_awready; ", "").replace("output s_axi_arready; ", "") + "input clk",
            "is missing",
        ),
    ],
)
def test_what_looks_like_a_bus_and_is_none_is_left_over_with_the_reason(
    tmp_path: Path, declarations: str, said: str
) -> None:
    found = ports(tmp_path, declarations)
    assert found.interfaces == ()
    assert said in found.leftovers[0].reason


@pytest.mark.parametrize(
    ("declarations", "buses"),
    [
        (stream("i_", "slave") + stream("o_", "master"), "i:slave o:master"),
        (stream("axis_i_", "slave") + stream("axis_o_", "master"), "axis_i:slave axis_o:master"),
        ("input [7:0] s_axis_i_tdata; input s_axis_i_tvalid; output s_axis_o_tready; ", "s_axis:slave"),
    ],
)
def test_directions_in_names_join_the_ports_of_one_bus_and_name_two(
    tmp_path: Path, declarations: str, buses: str
) -> None:
    found = ports(tmp_path, declarations + "input aclk").interfaces
    assert " ".join(f"{bus.name}:{bus.mode.value}" for bus in found) == buses
    assert {len(bus.ports) for bus in found} == {3}


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("module m (input clk); endmodule", {"top": "other"}, "no module other in .*; there are: m"),
        ("module m #(parameter WIDTH = 1) (input clk); endmodule", {"parameters": {"DEPTH": "1"}},
         "no parameter DEPTH in m; there are: WIDTH"),
        ("module m #(parameter WIDTH = 1) (input clk); endmodule", {"parameters": {"width": "1"}},
         "no parameter width in m; there are: WIDTH"),
        ("this is not a Verilog", {}, r"no module and no entity.*m\.v:1"),
        ("`pragma protect begin_protected\n`pragma protect end_protected\n", {}, r"encrypted.*component\.xml"),
        (None, {}, r"m\.v: cannot be read: No such file"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_with_what_there_is(
    tmp_path: Path, text: str | None, options: dict[str, Any], said: str
) -> None:
    if text is not None:
        (tmp_path / "m.v").write_text(text)
    with pytest.raises(HdlError, match=said):
        extract([tmp_path / "m.v"], **options)


def test_a_folder_in_place_of_its_files_is_refused(tmp_path: Path) -> None:
    with pytest.raises(HdlError, match=rf"^{re.escape(str(tmp_path))} is a folder: name the files in it"):
        extract([tmp_path])


def test_syntax_error_is_a_problem_of_the_module_with_its_line(tmp_path: Path) -> None:
    found = module(tmp_path, "module m (input clk);\nassign a = = 1;\nendmodule\n")
    assert [(p.line, p.fatal) for p in found.problems] == [(2, False)]
    assert [c.port for c in found.clocks] == ["clk"]


def test_an_error_in_an_included_file_is_reported_there(tmp_path: Path) -> None:
    (tmp_path / "w.svh").write_text("`define W 8\n\nassign = ;\n")
    found = module(tmp_path, '`include "w.svh"\nmodule m (input [`W-1:0] a);\nendmodule\n', name="m.sv")
    assert {(p.file, p.line) for p in found.problems} == {(str(tmp_path.resolve() / "w.svh"), 3)}


def test_an_error_in_a_package_is_reported_once_and_in_no_file_that_uses_it(tmp_path: Path) -> None:
    """A package between `ifndef and `endif counts as a file of macros too, for the files after it."""
    package, user = tmp_path / "p.sv", tmp_path / "m.sv"
    package.write_text("`ifndef P\n`define P\npackage p;\nlocalparam int W = ;\nendpackage\n`endif\n")
    user.write_text("module m (input [p::W-1:0] a);\nendmodule\n")
    found = read(Sources([package, user], top="m"))
    said = {(problem.file, problem.line) for problem in (*found.problems, *found.modules[0].problems) if problem.breaks}
    assert said == {(str(package), 4)}


def test_a_byte_order_mark_leaves_a_verilog_file_its_language(tmp_path: Path) -> None:
    (tmp_path / "m.v").write_text("module m (input clk);\nwire do, bit;\nendmodule\n", encoding="utf-8-sig")
    (found,) = extract([tmp_path / "m.v"])
    assert (found.language, found.problems) == (Language.VERILOG, ())


def test_a_file_in_utf_16_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "m.v").write_text("module m (input clk);\nendmodule\n", encoding="utf-16")
    with pytest.raises(HdlError, match=r"m\.v is UTF-16 text: save it as UTF-8$"):
        extract([tmp_path / "m.v"])


def test_missing_include_is_reported_and_its_ranges_cannot_be_evaluated(tmp_path: Path) -> None:
    found = module(tmp_path, '`include "no.vh"\nmodule m (input [`W-1:0] a);\nendmodule\n')
    assert found.problems[0].message == "'no.vh': No such file or directory: name its folder (include_dirs:, or -I)"
    assert found.port("a").width != 0


def test_parameter_without_a_default_is_asked_for(tmp_path: Path) -> None:
    found = ports(tmp_path, "input [W-1:0] a", "parameter int W", name="m.sv")
    assert found.port("a").width is None
    assert any("-P W=" in str(problem) for problem in found.problems)


def test_module_declared_twice_is_reported(tmp_path: Path) -> None:
    for name in ("a.v", "b.v"):
        (tmp_path / name).write_text("module m (input clk); endmodule")
    reading = read(Sources([tmp_path / "a.v", tmp_path / "b.v"]))
    assert len(reading.modules) == 1
    assert "declared in" in reading.problems[0].message


def test_package_in_another_file_is_known(tmp_path: Path) -> None:
    (tmp_path / "p.sv").write_text("package p; localparam int W = 12; endpackage")
    (tmp_path / "m.sv").write_text("module m (input logic [p::W-1:0] a); endmodule")
    assert extract([tmp_path / "p.sv", tmp_path / "m.sv"])[0].port("a").width == 12


def test_string_and_real_parameters_keep_their_kind(tmp_path: Path) -> None:
    header = 'parameter KIND = "fast", parameter real RATE = 1.5, parameter [3:0] N = 4\'hA'
    assert [p.value for p in ports(tmp_path, "input clk", header).parameters] == ["fast", 1.5, 10]


@pytest.mark.parametrize(
    ("given", "value"),
    [("2147483648", 1 << 31), ("-1", -1), ("8'hFF", 255), ("2*(3+1)", 8), ("True", 1), ("slow", "slow"), ('"x"', "x")],
)
def test_parameter_is_set_to_a_number_or_a_string(tmp_path: Path, given: str, value: object) -> None:
    found = ports(tmp_path, "input clk", "parameter P = 0", parameters={"P": given})
    assert [p.value for p in found.parameters] == [value]


def test_included_file_in_another_encoding_is_read(tmp_path: Path) -> None:
    (tmp_path / "w.vh").write_bytes("`define W 4 // à gauche\n".encode("latin-1"))
    text = '`include "w.vh"\nmodule m #(parameter P = /* \xe0 */ `W) (input [`W-1:0] a);\nendmodule\n'
    (tmp_path / "m.v").write_bytes(text.encode("latin-1"))
    (found,) = extract([tmp_path / "m.v"])
    assert (found.port("a").width, found.parameters[0].value) == (4, 4)


def test_missing_parser_is_reported_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyslang", None)
    with pytest.raises(ParserMissing, match=r"needs the Python package pyslang.*pip install 'pyslang>="):
        extract([DATA / "tagged.v"])


def test_file_of_macros_counts_for_the_files_after_it(tmp_path: Path) -> None:
    (tmp_path / "defs.v").write_text("`define W 8\n`define F(x) (x*2)\n")
    (tmp_path / "m.v").write_text("module m (input [`F(`W)-1:0] a);\nendmodule")
    (found,) = extract([tmp_path / "defs.v", tmp_path / "m.v"])
    assert (found.port("a").width, found.port("a").line, found.problems) == (16, 1, ())


def test_a_file_whose_name_is_not_utf8_is_read(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"gr\xf6\xdfer")
    folder.mkdir()
    (folder / "w.vh").write_text("`define W 8\n")
    (folder / "a.v").write_text("module a (input wire clk, output wire [`W-1:0] o);\nendmodule\n")
    (found,) = extract([folder / "w.vh", folder / "a.v"])
    assert found.name == "a"


def test_a_verilog_header_among_the_sources_leaves_systemverilog_its_keywords(tmp_path: Path) -> None:
    (tmp_path / "width.vh").write_text("`define WIDTH 8\n")
    (tmp_path / "sizes.sv").write_text("package sizes;\n    localparam int HIGH = `WIDTH * 2 - 1;\nendpackage\n")
    (tmp_path / "a.sv").write_text("module a (input logic clk, output logic [sizes::HIGH:0] o);\nendmodule\n")
    (found,) = extract([tmp_path.resolve() / name for name in ("width.vh", "sizes.sv", "a.sv")])
    assert (found.problems, found.port("o").width) == ((), 16)


def folders_of_exports(path: Path, count: int) -> list[Path]:
    """Folders with a top each, and a unit, a package and macros of one name, but of other widths."""
    files = []
    for number in range(count):
        folder = path / f"export{number}"
        folder.mkdir(parents=True)
        (folder / "defs.v").write_text(f"`define BITS {number + 1}\n")
        (folder / "types.sv").write_text(f"package types; localparam WIDTH = {number + 1}; endpackage\n")
        (folder / "unit.v").write_text("module unit (input clk); endmodule\n")
        top = f"module top{number} (input [types::WIDTH-1:0] a, input [`BITS-1:0] b); unit u (); endmodule\n"
        (folder / "top.sv").write_text(top)
        files += [folder / name for name in ("defs.v", "types.sv", "unit.v", "top.sv")]
    return files


def test_each_module_of_many_folders_sees_the_files_of_its_own_folder_first(tmp_path: Path) -> None:
    files = folders_of_exports(tmp_path, 3)
    found = read(Sources(files), roots=True)
    assert [(m.name, m.port("a").width, m.port("b").width) for m in found.modules] == [
        ("top0", 1, 1),
        ("top1", 2, 2),
        ("top2", 3, 3),
    ]
    assert [path for path in found.files["top1"] if path.name == "unit.v"] == [tmp_path / "export1" / "unit.v"]


def test_each_file_is_parsed_once_however_many_folders_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parsed: list[Path] = []
    once = VerilogReader._tree

    def counted(reader: VerilogReader, path: Path, *args: Any) -> Any:
        parsed.append(path)
        return once(reader, path, *args)

    monkeypatch.setattr(VerilogReader, "_tree", counted)
    files = folders_of_exports(tmp_path, 20)
    assert [one.info.name for one in read_inputs(Sources(files))[0]] == [f"top{number}" for number in range(20)]
    assert parsed == files


def test_an_array_without_a_value_is_asked_for_only_if_a_port_needs_it(tmp_path: Path) -> None:
    text = "module m #(parameter N = 2, parameter [N-1:0] A [N] = '{N{'0}}) (input [N-1:0] a); endmodule\n"
    assert not module(tmp_path, text, "m.sv").problems


def test_what_vivado_synthesises_all_the_same_does_not_stop_check(tmp_path: Path) -> None:
    (problem,) = module(tmp_path, "module m (input a); logic b; type(b) c; endmodule\n", "m.sv").problems
    assert "'var'" in problem.message
    assert not problem.breaks


NESTED = """
interface kinds_if; typedef logic [7:0] word; endinterface
interface lane_if (kinds_if kinds);
  typedef kinds.word word;
  logic valid, ready; word data;
  function automatic logic ack(); return valid & ready; endfunction
  modport sink (input valid, data, output ready, import ack);
endinterface
module m (kinds_if kinds, input logic clk, rst_n, lane_if.sink lane, output logic [7:0] q);
  lane_if inner[2] (kinds);
  always_ff @(posedge clk or negedge rst_n) if (!rst_n) q <= 0; else q <= lane.data;
  assign lane.ready = inner[0].ack();
endmodule
"""


def test_an_interface_with_an_interface_as_a_port_is_read_and_refused_by_name(tmp_path: Path) -> None:
    found = module(tmp_path, NESTED, "m.sv", top="m")
    assert [reset.clock for reset in found.resets] == ["clk"]
    assert any("port lane is a SystemVerilog interface" in problem.message for problem in found.problems)
