# SPDX-License-Identifier: Apache-2.0
"""VHDL of others: 43 entities of VLSI-EDA/PoC (894d3cd), with verdicts written by hand from their sources.

`POC=DIR make test SUITES=tests/corpus`: DIR is a checkout; nothing of it is in this repository. PoC's streams are
AXI4-Stream by other names; whether an Ack is a TREADY only the designer knows, so they are asked for. Its FIFOs (put,
full; valid, got) are asked for in other words.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

pytest.importorskip("tree_sitter_vhdl", reason="needs tree-sitter-vhdl: the extra [build] is not installed")

from cm.design.hdl.extract import Sources, read

POC = os.environ.get("POC")
PACKAGES = ("common/utils.vhdl", "common/vectors.vhdl", "bus/stream/stream.pkg.vhdl", "net/net.pkg.vhdl")
ONE, TWO = (("Clock",), ()), (("Clock1", "Clock2"), ())
SMALL = (("clk",), ("rst",))
SIDES = (("clk_wr", "clk_rd"), ("rst_wr", "rst_rd"))
WITH_RESET = (("Clock",), ("Reset",))
# clocks, resets; streams that are asked for
VERDICTS: dict[str, tuple[tuple[tuple[str, ...], tuple[str, ...]], tuple[str, ...]]] = {
    "fifo/fifo_cc_got": (SMALL, ()),
    "fifo/fifo_cc_got_tempgot": (SMALL, ()),
    "fifo/fifo_cc_got_tempput": (SMALL, ()),
    "fifo/fifo_glue": (SMALL, ()),
    "fifo/fifo_ic_assembly": (SIDES, ()),
    "fifo/fifo_ic_got": (SIDES, ()),
    "fifo/fifo_shift": (SMALL, ()),
    "bus/stream/stream_Buffer": (WITH_RESET, ("In", "Out")),
    "bus/stream/stream_DeMux": (WITH_RESET, ("In",)),
    "bus/stream/stream_FrameGenerator": (WITH_RESET, ("Out",)),
    "bus/stream/stream_Mirror": (WITH_RESET, ("In",)),
    "bus/stream/stream_Mux": (WITH_RESET, ("Out",)),
    "bus/stream/stream_Source": (WITH_RESET, ("Out",)),
    "io/uart/uart_bclk": (SMALL, ()),
    "io/uart/uart_fifo": (WITH_RESET, ()),
    "io/uart/uart_ft245": (SMALL, ()),
    "io/uart/uart_rx": (SMALL, ()),  # bclk_x8 enables
    "io/uart/uart_tx": (SMALL, ()),  # so does bclk
    "misc/filter/filter_and": (ONE, ()),
    "misc/filter/filter_mean": (ONE, ()),
    "misc/filter/filter_or": (ONE, ()),
    "misc/gearbox/gearbox_down_cc": (ONE, ()),
    "misc/gearbox/gearbox_down_dc": (TWO, ()),
    "misc/gearbox/gearbox_up_cc": (ONE, ()),
    "misc/gearbox/gearbox_up_dc": (TWO, ()),
    "misc/sync/sync_Bits": (ONE, ()),
    "misc/sync/sync_Bits_Altera": (ONE, ()),
    "misc/sync/sync_Bits_Xilinx": (ONE, ()),
    "misc/sync/sync_Command": (TWO, ()),
    "misc/sync/sync_Pulse": (ONE, ()),
    "misc/sync/sync_Pulse_Altera": (ONE, ()),
    "misc/sync/sync_Pulse_Xilinx": (ONE, ()),
    "misc/sync/sync_Reset": (ONE, ()),
    "misc/sync/sync_Reset_Altera": (ONE, ()),
    "misc/sync/sync_Reset_Xilinx": (ONE, ()),
    "misc/sync/sync_Strobe": (TWO, ()),
    "misc/sync/sync_Vector": (TWO, ()),
    "net/mac/mac_FrameLoopback": (WITH_RESET, ("In", "Out")),
    "net/mac/mac_RX_DestMAC_Switch": (WITH_RESET, ("In",)),
    "net/mac/mac_RX_SrcMAC_Filter": (WITH_RESET, ("In", "Out")),
    "net/mac/mac_RX_Type_Switch": (WITH_RESET, ("In",)),
    "net/mac/mac_TX_DestMAC_Prepender": (WITH_RESET, ("In", "Out")),
    "net/mac/mac_TX_SrcMAC_Prepender": (WITH_RESET, ("Out",)),
}
ASKED = re.compile(r"looks like a stream .* streams: \[(.*?)\] in the module")


def found(source: Path, name: str) -> tuple[tuple[set[str], set[str]], set[str], list[str]]:
    """Clocks and resets, streams that are asked for, and buses."""
    file = source / f"{name}.vhdl"
    info = next(m for m in read(Sources([*(source / p for p in PACKAGES), file])).modules if Path(m.file) == file)
    asked = {word.strip() for left in info.leftovers if (m := ASKED.match(left.reason)) for word in m[1].split(",")}
    return (
        ({c.port for c in info.clocks}, {r.port for r in info.resets}),
        asked,
        [interface.name for interface in info.interfaces],
    )


@pytest.mark.skipif(not POC, reason="POC does not name a checkout of github.com/VLSI-EDA/PoC")
def test_41_of_43_entities_are_judged_as_by_hand_and_no_bus_is_invented() -> None:
    source = Path(str(POC)) / "src"
    wrong = {}
    for name, ((clocks, resets), streams) in VERDICTS.items():
        said, asked, buses = found(source, name)
        assert buses == [], f"{name}: there is no AXI in it"
        assert asked <= set(streams), f"{name}: only {streams} are streams"
        if (said, asked) != ((set(clocks), set(resets)), set(streams)):
            wrong[name] = (said, asked)
    assert len(VERDICTS) == 43
    assert len(wrong) <= 2, wrong
