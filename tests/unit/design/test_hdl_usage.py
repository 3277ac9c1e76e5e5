# SPDX-License-Identifier: Apache-2.0
"""Clocks, resets and interrupts: by what the sources do with ports, and by names that say it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pyslang")
pytest.importorskip("tree_sitter_vhdl")

from hdl_support import module, ports, stream

from cm.design.hdl.model import ModuleInfo, Polarity, PortDirection


def told(found: ModuleInfo) -> str:
    """Clocks, and resets with their levels and clocks: "clk rst_n-clk"."""
    signs = {Polarity.LOW: "-", Polarity.HIGH: "+"}
    clocks = [clock.port for clock in found.clocks]
    return " ".join([*clocks, *(f"{r.port}{signs[r.polarity]}{r.clock}" for r in found.resets if r.polarity)])


# inputs of one bit → clocks and resets of these; whatever is left is a control, and named as left over
NAMED = [
    ("uclk urst vclk vresetn", "uclk vclk urst+uclk vresetn-vclk"),
    ("ce_clk bus_clk", "ce_clk bus_clk"),
    ("clk clk_bypass clk_override clk_polarity test_clk_mode rst_n", "clk rst_n-clk"),
    ("clk rst_n ff_reset counter_reset", "clk rst_n-clk"),
    ("clk rst_n sys_rst", "clk rst_n-clk sys_rst+clk"),
    ("clk rst_n core_rst_n", "clk rst_n-clk core_rst_n-clk"),
    ("clk soft_reset", "clk soft_reset+clk"),
    ("axi_clk aresetn ddr_sys_clk_p ddr_sys_clk_n sys_rst",
     "axi_clk ddr_sys_clk_p ddr_sys_clk_n aresetn-axi_clk sys_rst+ddr_sys_clk_p"),
]  # fmt: skip


@pytest.mark.parametrize(("names", "wanted"), NAMED)
def test_names_say_which_inputs_are_clocks_and_resets(names: str, wanted: str, tmp_path: Path) -> None:
    assert told(ports(tmp_path, "; ".join(f"input {name}" for name in names.split()))) == wanted


def test_counters_vectors_and_traces_of_interrupts_are_none(tmp_path: Path) -> None:
    outputs = "trace_interrupt_ip interrupt_count_o irq_vector_valid cfg_irq_level irq_uart"
    found = ports(tmp_path, "; ".join(f"output {name}" for name in outputs.split()) + "; input clk")
    assert [interrupt.port for interrupt in found.interrupts] == ["irq_uart"]


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
    inner one (.go(a), .stop(turned), .d(x), .q(y)), two (.go(a), .stop(turned));
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
