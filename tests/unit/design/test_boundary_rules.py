# SPDX-License-Identifier: Apache-2.0
"""What becomes of a signal that a module lacks: IHI 0022 (AXI4), A10, and IHI 0051 (AXI4-Stream), 2.2 and 3.1."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from cm.design.boundary.rules import Missing, Policy, lacks_input, lacks_output, policy
from cm.design.hdl.model import Mode

SLAVE, MASTER = Mode.SLAVE, Mode.MASTER
SIDEBAND = "TID TDEST TUSER"
IDS = "AWID WID BID ARID RID"
USERS = "AWUSER WUSER BUSER ARUSER RUSER"
HINTS = "AWLOCK AWCACHE AWPROT AWQOS AWREGION ARLOCK ARCACHE ARPROT ARQOS ARREGION"
WRITES = "AWVALID AWREADY AWADDR WVALID WREADY WDATA BVALID BREADY"
READS = "ARVALID ARREADY ARADDR RVALID RREADY RDATA"
FULL = "AWVALID AWADDR AWLEN ARVALID ARADDR ARLEN AWID ARID"

OUTPUTS = [  # protocol, mode, what the module has, signals that it should drive and lacks, what becomes of them
    ("axis", MASTER, "TVALID", "TKEEP TSTRB", Missing(1)),
    ("axis", SLAVE, "TVALID", "TREADY", Missing(1, note="has no TREADY: it takes every beat")),
    ("axis", MASTER, "TVALID", SIDEBAND, Missing(0)),
    ("axis", MASTER, "TVALID", "TLAST",
     Missing(refusal="drives no TLAST, which other modules do: its packets would have no end")),
    ("axis", MASTER, "TVALID", "TVALID TDATA", Missing(refusal="drives no {}")),
    ("pixels", MASTER, "", "err AWLEN", Missing(0, note="drives no {}: it reads as 0")),
    ("axi4", MASTER, "ARVALID", "AWVALID AWADDR WDATA WSTRB WLAST AWBURST AWID", Missing(0)),
    ("axi4", MASTER, "ARVALID", "BREADY", Missing(1)),
    ("axi4", MASTER, "AWVALID", "ARVALID ARADDR ARBURST ARID", Missing(0)),
    ("axi4", MASTER, "AWVALID", "RREADY", Missing(1)),
    ("axi4", MASTER, FULL, f"{HINTS} {IDS} {USERS} AWLEN ARLEN", Missing(0)),
    ("axi4", MASTER, FULL, "WSTRB", Missing(1)),
    ("axi4", MASTER, FULL, "WLAST AWBURST ARBURST AWSIZE ARSIZE WDATA RREADY BREADY",
     Missing(refusal="drives no {}, which has no safe default")),
    ("axi3", MASTER, "AWVALID ARVALID", "WLAST", Missing(1)),
    ("axi3", MASTER, "AWVALID ARVALID", "AWBURST ARBURST", Missing(0)),
    ("axi4", MASTER, "AWVALID AWLEN ARVALID", "ARBURST", Missing(0)),
    ("axi4", MASTER, "AWVALID ARVALID ARLEN", "AWBURST", Missing(0)),
    ("axi4", SLAVE, FULL, "BRESP RRESP", Missing(0, note="has no {}: every access reads as OKAY")),
    ("axi4", SLAVE, FULL, USERS, Missing(0)),
    ("axi4lite", SLAVE, "ARVALID", WRITES,
     Missing(refusal="has no write channels ({}): an access from software would hang the bus")),
    ("axi4lite", SLAVE, "AWVALID", READS,
     Missing(refusal="has no read channels ({}): an access from software would hang the bus")),
    ("axi3", SLAVE, FULL, "RLAST BID", Missing(refusal="drives no {}, which the region's other modules do")),
]  # fmt: skip
INPUTS = [
    ("axis", MASTER, "TVALID", "TREADY",
     Missing(refusal="has no TREADY and cannot wait, but the region's stream may stall: data would be lost")),
    ("axis", SLAVE, "TVALID", "TKEEP TSTRB", Missing(note="does not read {}: send it whole words only")),
    ("axis", SLAVE, "TVALID", f"TLAST {SIDEBAND}", Missing(note="does not read {}")),
    ("axis", SLAVE, "TVALID", "TDATA TVALID", Missing(refusal="does not read {}")),
    ("pixels", SLAVE, "", "err TREADY", Missing(note="does not read {}")),
    ("axi4", MASTER, "ARVALID", "AWREADY WREADY BVALID BRESP BID", Missing()),
    ("axi4", MASTER, "AWVALID", "ARREADY RVALID RRESP RID RDATA", Missing()),
    ("axi4", MASTER, FULL, f"{USERS} RLAST", Missing()),
    ("axi3", MASTER, FULL, "BRESP RRESP", Missing(note="does not read {}: it does not see bus errors")),
    ("axi4", MASTER, FULL, "BID RID AWREADY RDATA", Missing(refusal="does not read {}")),
    ("axi4", MASTER, "AWVALID ARVALID ARID", "BID", Missing()),
    ("axi4", MASTER, "AWVALID AWID ARVALID", "RID", Missing()),
    ("axi4", SLAVE, FULL, f"{HINTS} {USERS} WLAST", Missing()),
    ("axi4lite", SLAVE, FULL, "WSTRB", Missing(note="does not read WSTRB: write whole words only")),
    ("axi4", SLAVE, FULL, "AWSIZE ARSIZE", Missing(note="does not read {}: access whole words only")),
    ("axi4", SLAVE, FULL, f"AWLEN ARLEN AWADDR {IDS}", Missing(refusal="does not read {}")),
]  # fmt: skip


def filled(rule: Missing, signal: str) -> Missing:
    return Missing(rule.value, rule.note.format(signal), rule.refusal.format(signal))


@pytest.mark.parametrize(
    ("lacks", "protocol", "mode", "present", "signals", "rule"),
    [*((lacks_output, *row) for row in OUTPUTS), *((lacks_input, *row) for row in INPUTS)],
)
def test_a_signal_that_a_module_lacks_is_tied_or_left_or_refused(
    lacks: Callable[..., Missing], protocol: str, mode: Mode, present: str, signals: str, rule: Missing
) -> None:
    for signal in signals.split():
        assert lacks(protocol, mode, signal, present.split()) == filled(rule, signal)


@pytest.mark.parametrize(
    ("protocol", "mode", "signals", "wanted"),
    [
        ("axis", MASTER, SIDEBAND, Policy.WIDEST),
        ("axis", SLAVE, "TDATA TKEEP TSTRB AWID", Policy.SAME),
        ("pixels", SLAVE, "TUSER AWID AWADDR", Policy.SAME),
        *((axi, SLAVE, IDS, Policy.NARROWEST) for axi in ("axi3", "axi4", "axi4lite")),
        *((axi, MASTER, f"{IDS} AWADDR ARADDR {USERS}", Policy.WIDEST) for axi in ("axi3", "axi4", "axi4lite")),
        ("axi4", SLAVE, f"AWADDR ARADDR {USERS}", Policy.WIDEST),
        ("axi4", SLAVE, "WDATA RDATA AWLEN TUSER", Policy.SAME),
    ],
)
def test_widths_of_a_signal_are_reconciled_as_its_meaning_allows(
    protocol: str, mode: Mode, signals: str, wanted: Policy
) -> None:
    assert {policy(protocol, mode, signal) for signal in signals.split()} == {wanted}
