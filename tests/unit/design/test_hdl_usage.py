# SPDX-License-Identifier: Apache-2.0
"""Clocks, resets and interrupts: by what the sources do with ports, and by names that say it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pyslang")
pytest.importorskip("tree_sitter_vhdl")

from hdl_support import lite, module, ports, stream

from cm.design.hdl.model import ModuleInfo, Polarity, PortDirection, Stated


def told(found: ModuleInfo) -> str:
    """Clocks, and resets with their levels and clocks: "clk rst_n-clk"."""
    signs = {Polarity.LOW: "-", Polarity.HIGH: "+", None: "?"}
    clocks = [clock.port for clock in found.clocks]
    return " ".join([*clocks, *(f"{r.port}{signs[r.polarity]}{r.clock}" for r in found.resets)])


# inputs of one bit → clocks and resets of these; whatever is left is a control, and named as left over
NAMED = [
    ("uclk urst vclk vresetn", "uclk vclk urst+uclk vresetn-vclk"),
    ("ce_clk bus_clk", "ce_clk bus_clk"),
    ("clk clk_bypass clk_override clk_polarity test_clk_mode rst_n", "clk rst_n-clk"),
    ("clk rst_n ff_reset counter_reset", "clk rst_n-clk"),
    ("clk rst_n sys_rst", "clk rst_n-clk sys_rst+clk"),
    ("clk rst cold_reset pad_reset_detect", "clk rst+clk cold_reset+clk"),
    ("ClkData RstData ClkReg RstReg", "ClkData ClkReg RstData+ClkData RstReg+ClkReg"),
    ("clk tmc_disable_clock_gating clk_ovr_on clk_inh", "clk"),
    ("clk0_P clk0_N rst", "clk0_P clk0_N rst+clk0_P"),
    ("clk0p_pad clk0n_pad rst", "clk0p_pad clk0n_pad rst+clk0p_pad"),
    ("clk rst_n core_rst_n", "clk rst_n-clk core_rst_n-clk"),
    ("clk soft_reset", "clk soft_reset+clk"),
    ("clk rst_i set_i", "clk"),
    ("clkref tx_arestn", "clkref tx_arestn-clkref"),
    ("i_refck outclock pll_lock", "i_refck outclock"),
    ("clock pin_TRST_n_i_ival", "clock"),
    ("clk nrstin RstTxPauseRq", "clk nrstin-clk"),
    ("clk do_rst reset_na blk_reset_mon", "clk reset_na-clk"),
    ("clk aClkStopstate flash_clk_oeb cfg_clk90", "clk"),
    ("clk2x clk2xIndex", "clk2x"),
    ("clka clkb rsta rstb", "clka clkb rsta+clka rstb+clkb"),
    ("clk first_bit burst_len gt_prbscntreset qpllreset", "clk qpllreset+clk"),
    ("gt0_qplloutrefclk spi_sclk rxusrclk2", "gt0_qplloutrefclk rxusrclk2"),
    ("axi_clk aresetn ddr_sys_clk_p ddr_sys_clk_n sys_rst",
     "axi_clk ddr_sys_clk_p ddr_sys_clk_n aresetn-axi_clk sys_rst+ddr_sys_clk_p"),
]  # fmt: skip


@pytest.mark.parametrize(("names", "wanted"), NAMED)
def test_names_say_which_inputs_are_clocks_and_resets(names: str, wanted: str, tmp_path: Path) -> None:
    assert told(ports(tmp_path, "; ".join(f"input {name}" for name in names.split()))) == wanted


INTERRUPTS = {
    "sure": "irq_uart ext_irq_r:i ext_irq_a intr_tx_sent_o hart0_timerirq:i irq_n nmi nmi_i:i alarm_int_n irq_ch1 "
    "rx_valid_irq i_timer_int:i int_i:i IRQ_write irqs:8:i irq_0",
    "asked": "dsc_irq_late side_irq_support_o sleep_int:i mtip_o pulse_ipi inta_o",
    "none": "RDY_interrupt "
    "trace_interrupt_ip interrupt_count_o irq_vector_valid cfg_irq_level cfg_interrupt_msi_sent clk_int_o "
    "blowoff_int+blowoff_ext irq_events take_interrupt:i interrupt_inhibit_o irq_dsbl dat_int0:16 clr_int:8:i int_a:i "
    "irqActive:i",
}


@pytest.mark.parametrize(
    ("kind", "item"), [(kind, item) for kind, items in INTERRUPTS.items() for item in items.split()]
)
def test_a_name_is_surely_an_interrupts_or_leaves_a_doubt_or_says_none(kind: str, item: str, tmp_path: Path) -> None:
    names, *more = item.split(":")
    way = "input" if more[-1:] == ["i"] else "output"
    bits = f"[{int(more[0]) - 1}:0] " if more[:1] and more[0].isdigit() else ""
    found = ports(tmp_path, "; ".join(f"{way} {bits}{name}" for name in names.split("+")) + "; input clk")
    asked = [left.port for left in found.leftovers if "interrupts: [" in left.reason]
    assert [kind] == (["sure"] * len(found.interrupts) + ["asked"] * len(asked) or ["none"])


PROCESSES = {
    "if res = ACTIVE then q <= '0'; elsif clk'event and clk = EDGE then q <= d; end if;": "clk res?clk",
    "if rst_n = ACTIVE then q <= '0'; elsif rising_edge(clk) then q <= d; end if;": "clk rst_n-clk",
    "if rstn = '1' then if rising_edge(clk) then q <= d; end if; else q <= '0'; end if;": "clk rstn-clk",
    "if rst = '1' then if rising_edge(clk) then q <= d; end if; else q <= '0'; end if;": "clk rst-clk",
    "if iArst = cOn then q <= '0'; elsif rising_edge(clk) then q <= d; end if;": "clk iArst+clk",
    "if rst_n = '0' then if d = '1' then q <= '0'; else q <= '1'; end if; if d = '1' then q <= d; end if; "
    "elsif rising_edge(clk) then q <= d; end if;": "clk rst_n-clk",
    "if rst = '0' then assert d = q report d; end if; if rising_edge(clk) then q <= d; end if;": "clk rst+clk",
    "if load_en = '1' then q <= '0'; elsif rising_edge(clk) then q <= d; end if;": "clk",
}


@pytest.mark.parametrize(("process", "wanted"), PROCESSES.items())
def test_a_process_says_what_resets_it_before_or_around_its_edge(process: str, wanted: str, tmp_path: Path) -> None:
    name = process.split()[1]
    head = f"entity e is port (clk, {name}, d : in std_logic; q : out std_logic); end e;"
    head = f"package p is constant cOn : std_logic := '1'; end p; {head}"
    body = f"architecture a of e is begin p: process (clk, {name}) begin {process} end process p; end a;"
    assert told(module(tmp_path, f"library ieee; use ieee.std_logic_1164.all; {head} {body}", "e.vhd")) == wanted


def test_the_reset_of_a_serialiser_belongs_to_its_divided_clock(tmp_path: Path) -> None:
    head = "module m(input fast_clk, input slow_clk, input rst, input d, output q);"
    text = f"{head} OUT_SERDES s(.CLK(fast_clk), .CLKDIV(slow_clk), .RST(rst), .D(d), .Q(q)); endmodule"
    assert told(module(tmp_path, text)) == "fast_clk slow_clk rst+slow_clk"


def test_a_conversion_hides_no_reset(tmp_path: Path) -> None:
    head = "entity e is port (clk, rst_i, d : in std_logic; q : out std_logic); end e; architecture a of e is"
    body = "r <= std_ulogic(rst_i);\n p: process (clk, r) begin if r = '0' then q <= '0'; elsif rising_edge(clk) then"
    text = f"{head} signal r : std_ulogic; begin\n {body} q <= d; end if; end process; end a;"
    assert told(module(tmp_path, f"library ieee; use ieee.std_logic_1164.all; {text}", "e.vhd")) == "clk rst_i-clk"


@pytest.mark.parametrize(
    ("name", "head", "turned"),
    [
        ("m.v", "module m #(parameter LEVEL = 1'b0)(input clk, input arst, input d, output reg q);",
         "wire r = arst ^ LEVEL; always @(posedge clk or negedge r) if (!r) q <= 0; else q <= d; endmodule"),
        ("m.vhd", "entity m is generic (LEVEL : bit := '0'); port (clk, arst, d : in bit; q : out bit)",
         "; end m; architecture a of m is begin\n r <= arst xor LEVEL;\n p: process (clk, r) begin if r = '0' then "
         "q <= '0'; elsif rising_edge(clk) then q <= d; end if; end process p; end a;"),
    ],
)  # fmt: skip
def test_a_parameter_may_turn_a_reset_round(name: str, head: str, turned: str, tmp_path: Path) -> None:
    assert told(module(tmp_path, f"{head} {turned}", name)) == "clk arst-clk"


def test_what_is_only_asserted_clocks_nothing(tmp_path: Path) -> None:
    said = "property p; @(posedge edge_seen) d |-> q; endproperty assert property (@(posedge d) q |-> edge_seen);"
    said += ' always @(posedge d) begin if (q) $display("d"); end'
    text = f"module m(input clk, edge_seen, d, output reg q); always @(posedge clk) q <= d; {said} endmodule"
    assert told(module(tmp_path, text, "m.sv")) == "clk"


def test_an_output_at_the_interrupt_of_an_instance_is_asked_for(tmp_path: Path) -> None:
    text = "module m(input clk, input go, output late, early); part p(.irq_o(late), .done(early), .clk(clk)); endmodule"
    (asked,) = (left for left in module(tmp_path, text).leftovers if "interrupts: [" in left.reason)
    assert asked.port == "late"


def test_a_reset_that_is_left_to_something_inside_and_several_in_a_vector_are_named(tmp_path: Path) -> None:
    several = "input [3:0] fclk; input [1:0] refClkP; input [1:0] lane_rstn"
    found = ports(tmp_path, f"input clk; input rst_n; input ff_reset; {several}")
    reasons = {left.port: left.reason for left in found.leftovers}
    assert "resets: {ff_reset: {polarity: high}}" in reasons["ff_reset"]
    assert reasons["fclk"].startswith("is like 4 clocks")
    assert reasons["refClkP"].startswith("is like 2 clocks")
    assert reasons["lane_rstn"].startswith("is like 2 resets")


def test_a_clock_of_a_primitive_that_is_not_given_is_no_signal_of_another_clock(tmp_path: Path) -> None:
    pins = ".CLK(clk), .CLKDIV(div_clk), .D(d), .Q(q)"
    head = "module m(input clk, input div_clk, input d, output q);"
    assert told(module(tmp_path, f"{head} OUT_SERDES s({pins}); endmodule", "m.v")) == "clk div_clk"


def test_the_build_schema_says_which_ports_are_interrupts(tmp_path: Path) -> None:
    text = "output irq_uart; output late; output dsc_irq_arm_late; input clk"
    found = ports(tmp_path, text, stated=Stated(interrupts=("late",)))
    assert [(one.port, one.width) for one in found.interrupts] == [("late", 1)]
    assert ports(tmp_path, text, stated=Stated(interrupts=())).interrupts == ()


@pytest.mark.parametrize("name", ["cfg_en", "chip_sel", "ss"])
def test_what_resets_registers_by_a_name_of_something_else_is_asked_for(name: str, tmp_path: Path) -> None:
    text = f"always @(posedge clk or negedge {name}) if (!{name}) q <= 0; else q <= q + 1;"
    found = module(tmp_path, f"module m(input clk, input {name}, output reg [7:0] q); {text} endmodule", "m.v")
    assert told(found) == "clk"
    (left,) = (left for left in found.leftovers if left.port == name)
    assert f"resets: {{{name}: {{polarity: low}}}}" in left.reason


def test_a_register_may_be_reset_to_a_parameter(tmp_path: Path) -> None:
    text = "always @(posedge clk) if (stage1_rst) q <= {width{init_value}}; else q <= d;"
    head = "module m #(parameter width = 8, init_value = 0)(input clk, rst_n, stage1_rst, d, output reg [7:0] q);"
    assert "stage1_rst+clk" in told(module(tmp_path, f"{head} {text} endmodule", "m.v"))


def test_a_clock_may_be_chosen_from_two_even_if_one_is_sampled_too(tmp_path: Path) -> None:
    text = "wire c; assign c = sel ? a_clk : b_clk; always @(posedge c) q <= d; always @(posedge b_clk) was <= a_clk;"
    head = "module m(input a_clk, input b_clk, input sel, input d, output reg q, output reg was);"
    assert told(module(tmp_path, f"{head} {text} endmodule", "m.v")) == "a_clk b_clk"


def test_what_registers_only_sample_is_no_reset_if_its_name_says_what_for(tmp_path: Path) -> None:
    text = "always @(posedge clk) begin was <= reset_frame; if (was && ~reset_frame) q <= 0; end"
    head = "module m(input clk, input reset_frame, output reg [7:0] q); reg was; "
    assert told(module(tmp_path, f"{head}{text} endmodule", "m.v")) == "clk"
    tested = text.replace("was && ~reset_frame", "reset_frame")
    assert told(module(tmp_path, f"{head}{tested} endmodule", "m.v")) == "clk reset_frame+clk"


def test_a_stream_runs_on_a_clock_that_the_module_drives_if_that_has_its_name(tmp_path: Path) -> None:
    found = ports(tmp_path, f"output net_clk; input dclk; {stream('net_rx_', 'slave')}")
    assert found.interface("net_rx").clock == "net_clk"
    assert [(c.port, c.direction) for c in found.clocks] == [
        ("dclk", PortDirection.IN),
        ("net_clk", PortDirection.OUT),
    ]


def test_most_words_in_common_decide_the_clock(tmp_path: Path) -> None:
    sides = stream("rx_axis_fifo_", "master") + stream("tx_axis_fifo_", "slave")
    found = ports(tmp_path, f"input rx_fifo_clock; input tx_fifo_clock; {sides}")
    assert [(bus.name, bus.clock) for bus in found.interfaces] == [
        ("rx_axis_fifo", "rx_fifo_clock"),
        ("tx_axis_fifo", "tx_fifo_clock"),
    ]


def test_the_clock_of_amba_is_not_given_to_a_bus_of_another_name(tmp_path: Path) -> None:
    found = ports(tmp_path, f"input ACLK; input hclk; {stream('afi_', 'slave')} {stream('s_axis_', 'slave')}")
    assert [(bus.name, bus.clock) for bus in found.interfaces] == [("afi", None), ("s_axis", "ACLK")]
    (problem,) = found.problems
    assert "could not be determined: the clocks are hclk, ACLK" in problem.message


VERILOG = """
module inner (input go, input stop, input [7:0] d, output reg [7:0] q);
    always @(posedge go or negedge stop)
        if (!stop) q <= 8'd0; else q <= d;
endmodule
module m (input a, input b, input c, input enable, input [7:0] x, output [7:0] y, output reg [7:0] z);
    wire turned = ~b;
    inner one (.go(a), .stop(turned), .d(x), .q(y)), two (a, turned);
    always @(posedge c) if (enable) z <= x;
endmodule
"""
VHDL = """
library ieee; use ieee.std_logic_1164.all;
entity m is port (a, b, c, enable : in std_logic; x : in std_logic; y, z : out std_logic); end entity;
architecture rtl of m is
begin
  first : process (a, b) begin
    if b = '1' then y <= '0'; elsif rising_edge(a) then y <= x; end if;
  end process;
  second : process (c) begin
    if c'event and c = '1' then if enable = '1' then z <= x; end if; end if;
  end process;
end architecture;
"""


@pytest.mark.parametrize(
    ("text", "name"), [(VERILOG, "m.v"), (VHDL, "m.vhd")], ids=["Verilog, through an instance", "VHDL"]
)
def test_the_sources_show_clocks_and_resets_whatever_their_names(text: str, name: str, tmp_path: Path) -> None:
    found = module(tmp_path, text, name, top="m")
    assert told(found) == "a c b+a"
    assert "enable" in [left.port for left in found.leftovers]


LEVELS = [
    ("always @(posedge clk) if (!restart_rst) q <= 0; else q <= d;", "clk restart_rst-clk"),
    ("always @(posedge clk) if (restart_rst == 1'b0) q <= 0; else q <= d;", "clk restart_rst-clk"),
    ("always @(posedge clk) begin q <= d; if (restart_rst) begin q <= 1'b0; end end", "clk restart_rst+clk"),
    (
        "always @(posedge clk) if (restart_rst) q <= d; else q <= 0;",
        "clk restart_rst+clk",
    ),
]


@pytest.mark.parametrize(("body", "wanted"), LEVELS)
def test_the_level_of_a_reset_is_that_at_which_registers_get_constants(body: str, wanted: str, tmp_path: Path) -> None:
    text = f"module m (input clk, input restart_rst, input d, output reg q);\n{body}\nendmodule\n"
    assert told(module(tmp_path, text)) == wanted


def test_a_bus_runs_on_the_clock_at_whose_edges_the_sources_use_it(tmp_path: Path) -> None:
    text = f"""
module m (input one_clk, input two_clk, {stream("s_axis_", "slave").rstrip("; ").replace(";", ",")},
          {stream("pix_", "master").rstrip("; ").replace(";", ",").replace("output ", "output reg ")});
    reg busy;
    assign s_axis_tready = !busy;
    always @(posedge two_clk) busy <= s_axis_tvalid;
    always @(posedge one_clk) begin pix_tdata <= 0; pix_tvalid <= !pix_tready; end
endmodule
"""
    found = module(tmp_path, text)
    assert [(bus.name, bus.clock) for bus in found.interfaces] == [("s_axis", "two_clk"), ("pix", "one_clk")]


FIFO = """
module m (input tx_clk, input logic_clk, input tx_rst, input logic_rst, {});
    vendor_fifo fifo (.s_clk(logic_clk), .m_clk(tx_clk), .s_axis_tdata(tx_axis_tdata), .s_axis_tvalid(tx_axis_tvalid),
                      .s_axis_tready(tx_axis_tready));
endmodule
"""


def test_the_pins_of_an_unknown_instance_tell_more_than_the_names_of_ports(tmp_path: Path) -> None:
    found = module(tmp_path, FIFO.format(stream("tx_axis_", "slave").rstrip("; ").replace(";", ",")))
    assert (found.interface("tx_axis").clock, found.interface("tx_axis").reset) == ("logic_clk", "logic_rst")


CROSSED = """
module m (input a_clk, input a_rst, input b_clk, input b_rst, output reg a_in_b, output reg b_in_a, output reg late);
    always @(posedge b_clk or posedge a_rst) if (a_rst) a_in_b <= 1; else a_in_b <= 0;
    always @(posedge a_clk) b_in_a <= b_rst;
endmodule
"""


def test_a_reset_that_is_synchronised_to_another_clock_belongs_to_that_of_its_name(tmp_path: Path) -> None:
    assert told(module(tmp_path, CROSSED)) == "a_clk b_clk a_rst+a_clk b_rst+b_clk"


CHOSEN = """
module m #(parameter FAST = 0) (input s_axi_aclk, input up_clk, {});
    wire clk;
    reg r;
    generate if (FAST) begin assign clk = up_clk; end else begin assign clk = s_axi_aclk; end endgenerate
    always @(posedge clk) r <= s_axi_awvalid;
endmodule
"""


def test_a_clock_that_a_parameter_chooses_is_not_known_by_the_last_choice(tmp_path: Path) -> None:
    found = module(tmp_path, CHOSEN.format(lite("s_axi_").rstrip("; ").replace(";", ",")))
    assert found.interface("s_axi").clock == "s_axi_aclk"


def test_the_reset_of_a_bus_is_that_of_its_clocks_name(tmp_path: Path) -> None:
    found = ports(tmp_path, f"input S_AXI_ACLK; input S_AXI_ARESETN; input i_reset; {stream('S_AXIS_', 'slave')}")
    assert found.interface("S_AXIS").reset == "S_AXI_ARESETN"


def test_a_clock_that_is_driven_and_on_which_no_bus_runs_is_none(tmp_path: Path) -> None:
    text = f"""
module m (input tx_clk, output tx_clk_out, {stream("tx_", "slave").rstrip("; ").replace(";", ",")});
    reg r;
    always @(posedge tx_clk) r <= tx_tvalid;
endmodule
"""
    assert [clock.port for clock in module(tmp_path, text).clocks] == ["tx_clk"]
