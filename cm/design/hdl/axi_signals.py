# SPDX-License-Identifier: Apache-2.0
"""The signals of the AXI protocols (ARM IHI 0022 for AXI3, AXI4 and AXI4-Lite, IHI 0051 for AXI4-Stream).

A `Protocol` is data, and a user's own protocol is one too. Directions are the master's.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from types import MappingProxyType

from cm.design.hdl.model import Port, PortDirection
from cm.frozen import dataclass, field, replace

_IN, _OUT = PortDirection.IN, PortDirection.OUT
_ADDRESS_SIGNALS = ("ID", "ADDR", "LEN", "SIZE", "BURST", "LOCK", "CACHE", "PROT", "QOS", "REGION", "USER")


@dataclass(frozen=True, slots=True)
class Signal:
    """A logical signal: its direction at the master, and whether the bus must have it."""

    name: str
    direction: PortDirection
    required: bool = False
    handshake: bool = False  # always one bit: more bits mean several buses side by side
    spellings: tuple[str, ...] = ()  # alternative spellings in port names


@dataclass(frozen=True, slots=True)
class Protocol:
    """A bus protocol: of `halves`, sets of signals, at least one must be complete (AXI: write, read)."""

    name: str
    signals: Mapping[str, Signal]
    halves: tuple[frozenset[str], ...] = ()
    vlnv: str = ""
    pattern: re.Pattern[str] = field(default=re.compile(r"(?!)"), repr=False)
    spelled: Mapping[str, str] = field(default_factory=dict, repr=False)  # spelling, lower case → logical name
    company: bool = False  # one signal alone is not enough to recognise the protocol
    worth: tuple[frozenset[str], ...] = ()  # ports with none of these sets are not reported as a near miss


def make_protocol(
    name: str, signals: list[Signal], halves: tuple[frozenset[str], ...] = (), vlnv: str = "", company: bool = False
) -> Protocol:
    """Make a protocol with the pattern that finds its signals in port names: prefix, signal, tail."""
    spelled = {spelling: s.name for s in signals for spelling in (s.name.lower(), *s.spellings)}
    by_name = MappingProxyType({s.name: s for s in signals})
    return Protocol(name, by_name, halves, vlnv, _pattern(".*?", spelled), MappingProxyType(spelled), company)


def _pattern(prefix: str, spellings: Iterable[str]) -> re.Pattern[str]:
    names = "|".join(re.escape(spelling) for spelling in sorted(spellings, reverse=True))
    return re.compile(rf"(?P<prefix>{prefix})(?P<signal>{names})(?P<tail>(?:_(?:i|o|in|out|\d+))*)", re.IGNORECASE)


def _signals(text: str, direction: PortDirection, *, handshake: bool = False) -> list[Signal]:
    return [Signal(name, direction, handshake=handshake) for name in text.split()]


def _address(channel: str) -> list[Signal]:
    names = " ".join(channel + s for s in _ADDRESS_SIGNALS)
    return [
        *_signals(names, _OUT),
        *_signals(f"{channel}VALID", _OUT, handshake=True),
        *_signals(f"{channel}READY", _IN, handshake=True),
    ]


@cache
def aximm() -> Protocol:
    """AXI3, AXI4 and AXI4-Lite, which have the same signal names; `axi_flavour` tells them apart."""
    signals = [
        *_address("AW"),
        *_signals("WID WDATA WSTRB WUSER", _OUT),
        *_signals("WLAST WVALID BREADY", _OUT, handshake=True),
        *_signals("WREADY BVALID", _IN, handshake=True),
        *_signals("BID BRESP BUSER", _IN),
        *_address("AR"),
        *_signals("RID RDATA RRESP RUSER", _IN),
        *_signals("RLAST RVALID", _IN, handshake=True),
        *_signals("RREADY", _OUT, handshake=True),
    ]
    write = frozenset(["AWADDR", "AWVALID", "AWREADY", "WDATA", "WVALID", "WREADY", "BVALID", "BREADY"])
    read = frozenset(["ARADDR", "ARVALID", "ARREADY", "RDATA", "RVALID", "RREADY"])
    found = make_protocol("aximm", signals, (write, read), "xilinx.com:interface:aximm:1.0")
    return replace(found, worth=tuple(frozenset({name}) for name in ("AWVALID", "AWREADY", "ARVALID", "ARREADY")))


@cache
def axis() -> Protocol:
    """AXI4-Stream: TVALID and at least one signal beside it; TREADY is optional in the standard."""
    signals = [
        *_signals("TDATA TSTRB TKEEP TID TDEST TUSER", _OUT),
        *_signals("TLAST TVALID", _OUT, handshake=True),
        *_signals("TREADY", _IN, handshake=True),
    ]
    valid = frozenset({"TVALID"})
    found = make_protocol("axis", signals, (valid,), "xilinx.com:interface:axis:1.0", company=True)
    return replace(found, worth=(valid, frozenset({"TDATA", "TREADY"})))


@cache
def axis_short() -> Protocol:
    """AXI4-Stream without the standard's T, where the prefix says axis: `i_axis_valid`, `m_axis_video_data`.

    These are common names, so data, valid and ready must all be present.
    """
    standard = axis()
    spelled = {name[1:].lower(): name for name in standard.signals}
    word = r"(?:.*_)?(?:axis|axi_?stream|axi4_?stream|axi4s)\d*_(?:.*_)?"
    halves = (frozenset({"TDATA", "TVALID", "TREADY"}),)
    worth = (frozenset({"TDATA", "TVALID"}),)
    return replace(
        standard, halves=halves, worth=worth, pattern=_pattern(word, spelled), spelled=MappingProxyType(spelled)
    )


@cache
def acknowledged() -> Protocol:
    """A stream whose receiver acknowledges: `In_Valid`, `In_Data`, `In_Ack`, perhaps `In_SOF` and `In_EOF`.

    It is AXI4-Stream by other names if a beat is over when valid and ack are high (VLSI-EDA/PoC), and something else if
    ack is an answer that comes later: only the designer knows.
    """
    spelled = {"valid": "TVALID", "vld": "TVALID", "data": "TDATA", "ack": "TREADY", "sof": "TUSER", "eof": "TLAST"}
    halves = (frozenset({"TDATA", "TVALID", "TREADY"}),)
    pattern = _pattern(".+?", spelled)
    return replace(axis(), halves=halves, pattern=pattern, spelled=MappingProxyType(spelled))


_FULL_ONLY = frozenset(["AWLEN", "ARLEN", "AWSIZE", "ARSIZE", "AWBURST", "ARBURST", "WLAST", "RLAST", "WID"])
_AXI3_LEN_BITS = 4  # AXI4 has 8


def axi_flavour(ports: Mapping[str, Port]) -> str:
    """Return axi4lite, axi3 or axi4, by the signals present (IHI 0022, A10.3 and B1.1)."""
    if not _FULL_ONLY & set(ports):
        return "axi4lite"
    lengths = [ports[name].width for name in ("AWLEN", "ARLEN") if name in ports]
    if lengths:  # WID alone does not mean AXI3: HLS gives it to AXI4 masters
        return "axi3" if all(width == _AXI3_LEN_BITS for width in lengths) else "axi4"
    return "axi3" if "WID" in ports else "axi4"
