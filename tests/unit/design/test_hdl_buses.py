# SPDX-License-Identifier: Apache-2.0
"""Buses by their structure, whatever separates the words of their ports; what looks like a bus and is none is named."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pyslang")

from hdl_support import lite, ports, stream

from cm.design.hdl.model import Mode, Stated
from cm.frozen import replace

SIGNALS = {
    "aw": "addr:32 valid: ready:-",
    "w": "data:32 strb:4 valid: ready:-",
    "b": "resp:-2 valid:- ready:",
    "ar": "addr:32 valid: ready:-",
    "r": "data:-32 resp:-2 valid:- ready:",
}


def lite_as(spelling: str, bundle: str = "") -> str:
    """A master whose ports are spelled so: {c} and {s} are channel and signal, {b} the bundle of all but handshakes."""
    found = []
    for channel, signals in SIGNALS.items():
        for item in signals.split():
            name, bits = item.split(":")
            way = "input" if bits.startswith("-") else "output"
            width = f"[{int(bits.lstrip('-') or 1) - 1}:0] " if bits.lstrip("-") else ""
            inside = "" if name in ("valid", "ready") else bundle
            found.append(f"{way} {width}{spelling.format(c=channel, s=name, b=inside)}")
    return "; ".join([*found, "input clock"])


@pytest.mark.parametrize(
    ("spelling", "bundle", "name"),
    [
        ("cfg_{c}_{s}", "", "cfg"),
        ("cfg_{c}_{c}{s}", "", "cfg"),
        ("io_x_{c}_{b}{s}", "bits_", "io_x"),
        ("io_x_{c}_{b}{s}", "payload_", "io_x"),
        ("bus__{c}__{b}{s}", "payload__", "bus"),
        ("mst_{c}_{s}_i", "", "mst_i"),
    ],
)
def test_five_channels_are_a_bus_with_any_separator(spelling: str, bundle: str, name: str, tmp_path: Path) -> None:
    (bus,) = ports(tmp_path, lite_as(spelling, bundle)).interfaces
    assert (bus.name, bus.protocol, bus.mode, len(bus.ports)) == (name, "axi4lite", Mode.MASTER, 17)
    assert (bus.ports["WSTRB"], bus.clock) == (spelling.format(c="w", s="strb", b=bundle), "clock")


def test_strobes_have_their_short_name_too(tmp_path: Path) -> None:
    (bus,) = ports(tmp_path, lite("s_").replace("wstrb", "wstb") + "input clk").interfaces
    assert bus.ports["WSTRB"] == "s_wstb"


def test_words_behind_the_signals_are_part_of_the_buses_name(tmp_path: Path) -> None:
    text = "input [7:0] rx_tdata_mac; input rx_tvalid_mac; output rx_tready_mac; "
    text += "output [7:0] tx_tdata_to_mac; output tx_tvalid_to_mac; input tx_tready_to_mac; input clk"
    assert [(bus.name, len(bus.ports)) for bus in ports(tmp_path, text).interfaces] == [("rx_mac", 3), ("tx_to_mac", 3)]


def test_the_bundle_of_a_stream_is_no_part_of_its_name(tmp_path: Path) -> None:
    text = "input [7:0] s_axis_payload_data; input s_axis_payload_last; input s_axis_valid; output s_axis_ready; "
    (bus,) = ports(tmp_path, text + "input clk").interfaces
    assert (bus.name, sorted(bus.ports)) == ("s_axis", ["TDATA", "TLAST", "TREADY", "TVALID"])


def test_fifos_of_hls_are_stated(tmp_path: Path) -> None:
    text = "input [7:0] a_dout; input a_empty_n; output a_read; output [7:0] b_din; input b_full_n; output b_write; "
    found = ports(tmp_path, text + "input ap_clk")
    assert [(bus.name, bus.protocol, dict(bus.ports)) for bus in found.interfaces] == [
        ("a", "acc_fifo_read", {"RD_DATA": "a_dout", "EMPTY_N": "a_empty_n", "RD_EN": "a_read"}),
        ("b", "acc_fifo_write", {"WR_DATA": "b_din", "FULL_N": "b_full_n", "WR_EN": "b_write"}),
    ]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[1:0] s_rresp", "[3:0] s_rresp", "s_rresp has 4 bits: it is ACE"),
        ("[3:0] s_wstrb", "[7:0] s_wstrb", "s_wstrb has 8 bits for the 32 of s_wdata: WSTRB has one for each byte"),
        ("input s_awvalid", "input [31:0] s_awlen; input s_awvalid", "s_awlen has 32 bits, and AWLEN has 8 or 4"),
        ("input s_awvalid", "input [3:0] s_awprot; input s_awvalid", "s_awprot has 4 bits, and AWPROT has 3"),
    ],
)
def test_what_breaks_a_width_of_the_protocol_is_no_bus_of_it(old: str, new: str, said: str, tmp_path: Path) -> None:
    found = ports(tmp_path, lite("s_").replace(old, new) + "input clk")
    assert found.interfaces == ()
    assert [said in left.reason for left in found.leftovers if left.port == "s_awvalid"] == [True]


def test_a_signal_with_a_further_word_stays_out_of_the_bus(tmp_path: Path) -> None:
    found = ports(tmp_path, stream("s_axis_", "slave") + "output [7:0] s_axis_tdata_seen; input clk")
    assert [(bus.name, len(bus.ports)) for bus in found.interfaces] == [("s_axis", 3)]
    assert [left.port for left in found.leftovers] == ["s_axis_tdata_seen"]


def test_the_side_of_a_stream_may_be_a_letter(tmp_path: Path) -> None:
    text = "input [7:0] idat; input ivld; output irdy; output [7:0] odat; output ovld; input ordy; input clk"
    assert ports(tmp_path, text).asked == ("i", "o")


@pytest.mark.parametrize("reset", ["In_RstIn", "In_rst_n", "In_rst_ni", "In_link_reset"])
def test_a_reset_with_the_name_of_a_stream_is_that_of_its_side(reset: str, tmp_path: Path) -> None:
    text = f"input In_Clk; input {reset}; input In_Meta_rst; input [7:0] In_Data; input In_Valid; output In_Ready"
    found = ports(tmp_path, text)
    assert [(item.port, item.clock) for item in found.resets] == [(reset, "In_Clk")]
    assert "goes with the stream In" in [left.reason for left in found.leftovers]


def test_a_stream_called_after_its_data_may_have_affixes_of_direction(tmp_path: Path) -> None:
    found = ports(tmp_path, "output [7:0] digest_o; output digest_valid_o; input clk")
    assert {left.port for left in found.leftovers if "a stream without ready" in left.reason} == {
        "digest_o",
        "digest_valid_o",
    }


def test_channels_of_a_bus_that_is_none_are_no_streams(tmp_path: Path) -> None:
    text = lite_as("cfg_{c}_{s}").replace("input [1:0] cfg_r_resp", "input [3:0] cfg_r_resp")
    found = ports(tmp_path, text)
    assert (found.interfaces, found.asked) == ((), ())
    assert "it is ACE" in {left.port: left.reason for left in found.leftovers}["cfg_w_data"]


def test_a_parameter_without_a_usual_value_does_not_hide_a_bus(tmp_path: Path) -> None:
    text = lite("s_").replace("[31:0]", "[WIDTH-1:0]").replace("[3:0]", "[WIDTH/8-1:0]") + "input clk"
    assert [bus.protocol for bus in ports(tmp_path, text, "parameter WIDTH = 0").interfaces] == ["axi4lite"]


def test_the_port_map_of_a_component_goes_before_names(tmp_path: Path) -> None:
    text = "input [7:0] s_axis_tdata_l; input s_axis_tvalid_l; output s_axis_tready_l; input clk"
    named = ports(tmp_path, text)
    (bus,) = named.interfaces
    stated = replace(named, interfaces=(replace(bus, name="left", vlnv="xilinx.com:interface:axis:1.0"),))
    assert [(i.name, len(i.ports)) for i in ports(tmp_path, text, described=stated).interfaces] == [("left", 3)]


MIRRORED = """
input i_axis_tvalid; output o_axis_tready; input [7:0] i_axis_tdata;
output o_axis_tvalid; input i_axis_tready; output [7:0] o_axis_tdata
"""


def test_two_sides_whose_affixes_show_directions_are_two_streams(tmp_path: Path) -> None:
    found = ports(tmp_path, MIRRORED)
    assert [(bus.name, bus.mode.value) for bus in found.interfaces] == [("i_axis", "slave"), ("o_axis", "master")]
    plain = ports(tmp_path, MIRRORED.replace("axis_t", ""))
    assert plain.asked == ("i", "o")


NAMED = {
    "wbm_cyc_i wbm_stb_i": "Wishbone",
    "wbs_cyc_i wbs_stb_i wbs_ack_o": "Wishbone",
    "wb_ibus_cyc_o wb_ibus_ack_i": "Wishbone",
    "m_axis_tvalid_i m_axis_tlast_i": "it has neither data nor ready",
    "s_psel_i s_penable_i": "APB",
    "cmd_valid_i cmd_ready_o": "a handshake",
    "req_val_i req_accept_o": "a handshake",
    "valid_cam_i ready_cam_o": "a handshake",
    "rx_src_rdy_i rx_dst_rdy_o": "a handshake",
    "x_valid_i x_data_i": "a stream without ready: streams: [x]",
    "axi_m_wvalid_o axi_m_wready_i axi_m_wdata_o": "AXI bus axi_m",
}


@pytest.mark.parametrize(("names", "said"), NAMED.items())
def test_what_is_no_bus_of_a_region_is_named(names: str, said: str, tmp_path: Path) -> None:
    ways = {"i": "input", "o": "output"}
    found = ports(tmp_path, "; ".join(f"{ways[name[-1]]} {name}" for name in names.split()))
    assert all(said in left.reason for left in found.leftovers)
    assert [left.port for left in found.leftovers] == names.split()


def test_a_stream_may_be_called_after_its_data(tmp_path: Path) -> None:
    text = "input clk; input [3:0] tag; input tag_valid; output tag_ready"
    assert ports(tmp_path, text).asked == ("tag",)
    (found,) = ports(tmp_path, text, stated=Stated(streams=("tag",))).interfaces
    assert found.ports == {"TDATA": "tag", "TVALID": "tag_valid", "TREADY": "tag_ready"}


def test_a_stream_may_lack_the_t_of_its_data_or_have_it_in_trdy(tmp_path: Path) -> None:
    found = ports(tmp_path, "input a_tvalid; output a_trdy; input [7:0] a_data; input a_last; output a_user; input clk")
    (bus,) = found.interfaces
    assert bus.ports == {"TDATA": "a_data", "TLAST": "a_last", "TVALID": "a_tvalid", "TREADY": "a_trdy"}
