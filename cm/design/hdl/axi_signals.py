# SPDX-License-Identifier: Apache-2.0
"""The signals of the AXI protocols (ARM IHI 0022 for AXI3, AXI4 and AXI4-Lite, IHI 0051 for AXI4-Stream).

A `Protocol` is data, and a user's own protocol is one too. Directions are the master's.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
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
    widths: tuple[int, ...] = ()  # those that the protocol allows; any if there is none


@dataclass(frozen=True, eq=False, slots=True)
class Protocol:
    """A bus protocol: of `halves`, sets of signals, at least one must be complete (AXI: write, read).

    One is equal to itself only: what is found in a name is kept for it (`cm.design.hdl.group_ports`).
    """

    name: str
    signals: Mapping[str, Signal]
    halves: tuple[frozenset[str], ...] = ()
    vlnv: str = ""
    spelled: Mapping[str, str] = field(default_factory=dict, repr=False)  # spelling, lower case → logical name
    ends: frozenset[str] = field(default=frozenset(), repr=False)  # the last words of the spellings
    company: bool = False  # one signal alone is not enough to recognise the protocol
    worth: tuple[frozenset[str], ...] = ()  # ports with none of these sets are not reported as a near miss
    prefix: re.Pattern[str] | None = field(default=None, repr=False)  # what must stand before the signal
    channels: Mapping[str, str] = field(default_factory=dict, repr=False)  # signal → the channel whose name begins it
    glued: bool = False  # the side may be a letter before the signal: `idat`, `ovld`
    distinct: bool = False  # its signals are no common words: other words may stand behind them


def make_protocol(
    name: str, signals: list[Signal], halves: tuple[frozenset[str], ...] = (), vlnv: str = "", company: bool = False
) -> Protocol:
    """Make a protocol whose signals are found in port names by their own names, and by their spellings."""
    spelled = {spelling: s.name for s in signals for spelling in (s.name.lower(), *s.spellings)}
    by_name = MappingProxyType({s.name: s for s in signals})
    return _with_spellings(Protocol(name, by_name, halves, vlnv, company=company), spelled)


def _with_spellings(protocol: Protocol, spelled: Mapping[str, str]) -> Protocol:
    ends = frozenset(spelling.rpartition("_")[2] for spelling in spelled)
    return replace(protocol, spelled=MappingProxyType(dict(spelled)), ends=ends)


def _signals(text: str, direction: PortDirection, *, handshake: bool = False) -> list[Signal]:
    return [Signal(name, direction, handshake=handshake) for name in text.split()]


# IHI 0022, tables A2-2 to A2-6; AXI3's length has 4 bits, and its lock 2
_FIXED = {"LEN": (8, 4), "SIZE": (3,), "BURST": (2,), "LOCK": (1, 2), "CACHE": (4,), "PROT": (3,), "QOS": (4,)}
_FIXED |= {"REGION": (4,), "RESP": (2,)}
_SPELLED = {"wstrb": ("wstb", "wstrobe")}
_STREAM_SPELLED = {"TREADY": ("trdy",), "TVALID": ("tvld",)}


def _address(channel: str) -> list[Signal]:
    names = " ".join(channel + s for s in _ADDRESS_SIGNALS)
    return [
        *_signals(names, _OUT),
        *_signals(f"{channel}VALID", _OUT, handshake=True),
        *_signals(f"{channel}READY", _IN, handshake=True),
    ]


def _channel(name: str) -> str:
    return name[:2] if name.startswith(("aw", "ar")) else name[:1]


def _of_channel(signal: Signal) -> Signal:
    """With the spellings of an AXI signal that keep its channel apart (`aw_addr`), and its widths."""
    name = signal.name.lower()
    channel = _channel(name)
    own = (name, *_SPELLED.get(name, ()))
    spellings = (f"{channel}_{whole.removeprefix(channel)}" for whole in own)
    widths = _FIXED.get(signal.name.removeprefix(channel.upper()), ())
    return replace(signal, spellings=(*own[1:], *spellings), widths=widths)


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
    found = make_protocol("aximm", [*map(_of_channel, signals)], (write, read), "xilinx.com:interface:aximm:1.0")
    worth = tuple(frozenset({name}) for name in ("AWVALID", "AWREADY", "ARVALID", "ARREADY"))
    channels = {s.name: _channel(s.name.lower()) for s in signals}
    return replace(found, worth=worth, distinct=True, channels=MappingProxyType(channels))


@cache
def axis() -> Protocol:
    """AXI4-Stream: TVALID and at least one signal beside it; TREADY is optional in the standard."""
    signals = [
        *_signals("TDATA TSTRB TKEEP TID TDEST TUSER", _OUT),
        *_signals("TLAST TVALID", _OUT, handshake=True),
        *_signals("TREADY", _IN, handshake=True),
    ]
    signals = [replace(signal, spellings=_STREAM_SPELLED.get(signal.name, ())) for signal in signals]
    valid = frozenset({"TVALID"})
    found = make_protocol("axis", signals, (valid,), "xilinx.com:interface:axis:1.0", company=True)
    return replace(found, worth=(valid, frozenset({"TDATA", "TREADY"})), distinct=True)


@cache
def axis_short() -> Protocol:
    """AXI4-Stream without the standard's T, where the prefix says axis: `i_axis_valid`, `m_axis_video_data`.

    These are common names, so data, valid and ready must all be present.
    """
    standard = axis()
    spelled = {name[1:].lower(): name for name in standard.signals}
    word = re.compile(r"(?:.*_)?(?:axis|axi_?stream|axi4_?stream|axi4s)\d*_(?:.*_)?", re.IGNORECASE)
    halves = (frozenset({"TDATA", "TVALID", "TREADY"}),)
    worth = (frozenset({"TDATA", "TVALID"}),)
    return _with_spellings(replace(standard, halves=halves, worth=worth, prefix=word, distinct=False), spelled)


@cache
def plain_stream() -> Protocol:
    """A stream by common words: `pix_data`, `pix_valid`, `pix_ready`, or `In_Ack` and `In_SOF` as VLSI-EDA/PoC has it.

    It is AXI4-Stream by other names if a beat is over when valid and ready (or ack) are high, and something else if the
    ready of a later clock is meant, or ack is an answer that comes later: only the designer knows.
    """
    spelled = {
        "valid": "TVALID",
        "vld": "TVALID",
        "pvld": "TVALID",
        "data": "TDATA",
        "dat": "TDATA",
        "pd": "TDATA",
        "ack": "TREADY",
        "accept": "TREADY",
        "ready": "TREADY",
        "rdy": "TREADY",
        "prdy": "TREADY",
        "src_rdy": "TVALID",  # LocalLink's, each side ready
        "dst_rdy": "TREADY",
    }
    spelled |= {"sof": "TUSER", "user": "TUSER", "eof": "TLAST", "last": "TLAST", "keep": "TKEEP"}
    halves = (frozenset({"TDATA", "TVALID"}),)
    plain = replace(axis(), halves=halves, prefix=re.compile(".*"), distinct=False, glued=True)
    return _with_spellings(plain, spelled)


@cache
def hls_fifos() -> tuple[Protocol, Protocol]:
    """The two sides of a FIFO as Vitis HLS names them (UG1399, ap_fifo); the bus definitions are Vivado's."""
    reads = [("RD_DATA", _IN, "dout"), ("EMPTY_N", _IN, "empty_n"), ("RD_EN", _OUT, "read")]
    writes = [("WR_DATA", _OUT, "din"), ("FULL_N", _IN, "full_n"), ("WR_EN", _OUT, "write")]
    return _hls_fifo("acc_fifo_read", reads), _hls_fifo("acc_fifo_write", writes)


def _hls_fifo(name: str, signals: list[tuple[str, PortDirection, str]]) -> Protocol:
    made = [Signal(n, way, True, not n.endswith("DATA"), (spelling,)) for n, way, spelling in signals]
    every = frozenset(signal.name for signal in made)
    return replace(make_protocol(name, made, vlnv=f"xilinx.com:interface:{name}:1.0"), worth=(every,))


@cache
def other_buses() -> tuple[Protocol, ...]:
    """What shows a bus that is none of a region's, and is named for that: Wishbone B4, APB, AHB, Avalon, FIFOs."""
    handshake = make_protocol("a handshake", [*_marks("valid", _OUT), *_marks("ready", _IN)])
    spelled = dict.fromkeys(("valid", "vld", "val", "src_rdy"), "valid")
    spelled |= dict.fromkeys(("ready", "rdy", "accept", "dst_rdy"), "ready")
    writes = dict.fromkeys(("wr_en", "wren", "wen", "write", "push"), "put") | dict.fromkeys(("full", "wfull"), "full")
    reads = dict.fromkeys(("rd_en", "rden", "ren", "read", "pop"), "got") | dict.fromkeys(("empty", "rempty"), "empty")
    sides = ((("put", "full"), writes), (("got", "empty"), reads))
    fifos = ((make_protocol("a FIFO", [*_marks(a, _OUT), *_marks(b, _IN)]), named) for (a, b), named in sides)
    return (
        make_protocol("Wishbone", [*_marks("cyc stb", _OUT), *_marks("ack", _IN)]),
        make_protocol("Wishbone", _marks("cyc stb", _OUT)),
        *(make_protocol("Wishbone", [*_marks(name, _OUT), *_marks("ack", _IN)]) for name in ("cyc", "stb")),
        make_protocol("APB", _marks("psel penable", _OUT)),
        make_protocol("AHB", _marks("haddr htrans", _OUT)),
        make_protocol("Avalon-MM", [*_marks("address", _OUT), *_marks("waitrequest", _IN)]),
        make_protocol("Avalon-ST", _marks("startofpacket endofpacket", _OUT)),
        replace(_with_spellings(handshake, spelled), distinct=True),
        *(_with_spellings(side, named) for side, named in fifos),
    )


def _marks(names: str, direction: PortDirection) -> list[Signal]:
    return [Signal(name, direction, required=True) for name in names.split()]


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
