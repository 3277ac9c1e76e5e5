# SPDX-License-Identifier: Apache-2.0
"""The signals of the AXI protocols (ARM IHI 0022 for AXI3, AXI4 and AXI4-Lite, IHI 0051 for AXI4-Stream).

A `Protocol` is data, and a user's own protocol is one too. Directions are the master's.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from cm.build.hdl.model import Port, PortDirection

_IN, _OUT = PortDirection.IN, PortDirection.OUT
_ADDRESS_SIGNALS = ("ID", "ADDR", "LEN", "SIZE", "BURST", "LOCK", "CACHE", "PROT", "QOS", "REGION", "USER")


@dataclass(frozen=True, slots=True)
class Signal:
    """A logical signal: its direction at the master, and whether the bus is none without it."""

    name: str
    direction: PortDirection
    required: bool = False
    handshake: bool = False  # one bit by its nature: more bits mean several buses side by side
    spellings: tuple[str, ...] = ()  # further names it goes by in port names
    width: int | None = None  # a user protocol may fix it


@dataclass(frozen=True, slots=True)
class Protocol:
    """A bus protocol: `halves` are sets of signals of which one must be there whole (AXI: write, read)."""

    name: str
    signals: Mapping[str, Signal]
    halves: tuple[frozenset[str], ...] = ()
    vlnv: str = ""
    pattern: re.Pattern[str] = field(default=re.compile(r"(?!)"), repr=False)
    spelled: Mapping[str, str] = field(default_factory=dict, repr=False)  # spelling, lower case → logical name
    company: bool = False  # one signal alone is not enough to tell the protocol
    worth: tuple[frozenset[str], ...] = ()  # without any of these sets, ports are not said to look like the bus


def make_protocol(
    name: str, signals: list[Signal], halves: tuple[frozenset[str], ...] = (), vlnv: str = "", company: bool = False
) -> Protocol:
    """A protocol with the pattern by which its signals are told in port names: prefix, signal, tail."""
    spelled = {spelling: s.name for s in signals for spelling in (s.name.lower(), *s.spellings)}
    by_name = MappingProxyType({s.name: s for s in signals})
    return Protocol(name, by_name, halves, vlnv, _pattern(".*?", spelled), MappingProxyType(spelled), company)


def _pattern(prefix: str, spellings: Iterable[str]) -> re.Pattern[str]:
    names = "|".join(re.escape(spelling) for spelling in sorted(spellings, key=len, reverse=True))
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


def aximm() -> Protocol:
    """AXI3, AXI4 and AXI4-Lite, which share their names; `axi_flavour` tells them apart."""
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


def axis_short() -> Protocol:
    """AXI4-Stream without the standard's T, where the prefix says axis: `i_axis_valid`, `m_axis_video_data`.

    The names are common ones, so data, valid and ready must all be there.
    """
    standard = axis()
    spelled = {name[1:].lower(): name for name in standard.signals}
    word = r"(?:.*_)?(?:axis|axi_?stream|axi4_?stream|axi4s)\d*_(?:.*_)?"
    halves = (frozenset({"TDATA", "TVALID", "TREADY"}),)
    worth = (frozenset({"TDATA", "TVALID"}),)
    return replace(
        standard, halves=halves, worth=worth, pattern=_pattern(word, spelled), spelled=MappingProxyType(spelled)
    )


_FULL_ONLY = frozenset(["AWLEN", "ARLEN", "AWSIZE", "ARSIZE", "AWBURST", "ARBURST", "WLAST", "RLAST", "WID"])
_AXI3_LEN_BITS = 4  # AXI4 has 8


def axi_flavour(ports: Mapping[str, Port]) -> str:
    """axi4lite, axi3 or axi4, from the signals there are (IHI 0022, A10.3 and B1.1)."""
    if not _FULL_ONLY & set(ports):
        return "axi4lite"
    lengths = [ports[name].width for name in ("AWLEN", "ARLEN") if name in ports]
    if lengths:  # WID alone does not tell: HLS gives its AXI4 masters one
        return "axi3" if all(width == _AXI3_LEN_BITS for width in lengths) else "axi4"
    return "axi3" if "WID" in ports else "axi4"
