# SPDX-License-Identifier: Apache-2.0
"""How one signal of a bus may be adapted, and what is safe if a module lacks it.

Sources: IHI 0022 (AXI4), chapter A10 "Default signal values"; IHI 0051 (AXI4-Stream), 2.2 and 3.1 "Default values".
What is not known to be safe is refused.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

from cm.design.hdl.model import Mode
from cm.frozen import dataclass


class Policy(str, Enum):
    """How widths of one signal are reconciled among the modules."""

    SAME = "same"  # equal, or the module is refused
    WIDEST = "widest"  # zeros above what a module drives; high bits that a module does not read are dropped
    NARROWEST = "narrowest"  # must come back exactly as it came in, so every module has to see all of it


@dataclass(frozen=True, slots=True)
class Missing:
    """What happens if a module lacks a signal that the boundary has.

    `value`: the tie-off (all bits 0, all bits 1), None if there is none; `refusal`: why it is not possible.
    """

    value: int | None = None
    note: str = ""
    refusal: str = ""


_STREAM_SIDEBAND = ("TID", "TDEST", "TUSER")
_IDS = ("AWID", "WID", "BID", "ARID", "RID")
_USERS = ("AWUSER", "WUSER", "BUSER", "ARUSER", "RUSER")
_ADDRESSES = ("AWADDR", "ARADDR")
_HINTS = tuple(channel + name for channel in ("AW", "AR") for name in ("LOCK", "CACHE", "PROT", "QOS", "REGION"))
_WRITE = ["AWVALID", "AWREADY", "AWADDR", "WVALID", "WREADY", "WDATA", "BVALID", "BREADY"]
_READ = ["ARVALID", "ARREADY", "ARADDR", "RVALID", "RREADY", "RDATA"]
_ZERO, _ONES = Missing(0), Missing(1)


def policy(protocol: str, mode: Mode, signal: str) -> Policy:
    """The policy for a signal of a protocol."""
    if protocol == "axis":
        return Policy.WIDEST if signal in _STREAM_SIDEBAND else Policy.SAME
    if protocol not in ("axi4", "axi3", "axi4lite"):
        return Policy.SAME
    if signal in _IDS:
        # A slave must return every bit of an ID; a master's responses carry the IDs that it sent.
        return Policy.NARROWEST if mode is Mode.SLAVE else Policy.WIDEST
    return Policy.WIDEST if signal in (*_ADDRESSES, *_USERS) else Policy.SAME


def lacks_output(protocol: str, mode: Mode, signal: str, present: Iterable[str]) -> Missing:
    """The rule for a signal that the module should drive but does not have; `present`: the signals it has."""
    if protocol == "axis":
        return _stream_output(signal)
    if protocol in ("axi4", "axi3", "axi4lite"):
        have = set(present)
        return _master_output(signal, have) if mode is Mode.MASTER else _slave_output(signal)
    return Missing(0, note=f"drives no {signal}: it reads as 0")


def lacks_input(protocol: str, mode: Mode, signal: str, present: Iterable[str]) -> Missing:
    """The rule for a signal that the module should read but does not have."""
    if protocol == "axis":
        return _stream_input(mode, signal)
    if protocol in ("axi4", "axi3", "axi4lite"):
        have = set(present)
        return _master_input(signal, have) if mode is Mode.MASTER else _slave_input(signal)
    return Missing(note=f"does not read {signal}")


def _stream_output(signal: str) -> Missing:
    if signal in ("TKEEP", "TSTRB"):
        return _ONES
    if signal == "TREADY":
        return Missing(1, note="has no TREADY: it takes every beat")
    if signal in _STREAM_SIDEBAND:
        return _ZERO
    if signal == "TLAST":
        return Missing(refusal="drives no TLAST, which other modules do: its packets would have no end")
    return Missing(refusal=f"drives no {signal}")


def _stream_input(mode: Mode, signal: str) -> Missing:
    if mode is Mode.MASTER:  # TREADY
        return Missing(refusal="has no TREADY and cannot wait, but the region's stream may stall: data would be lost")
    if signal in ("TKEEP", "TSTRB"):
        return Missing(note=f"does not read {signal}: send it whole words only")
    if signal == "TLAST" or signal in _STREAM_SIDEBAND:
        return Missing(note=f"does not read {signal}")
    return Missing(refusal=f"does not read {signal}")


def _master_output(signal: str, have: set[str]) -> Missing:
    channel = signal[:2] if signal.startswith(("AW", "AR")) else ""
    if _absent_half(signal, have):
        return _ONES if signal in ("BREADY", "RREADY") else _ZERO
    if signal in (*_HINTS, *_IDS, *_USERS):
        return _ZERO
    if signal == "WSTRB":
        return _ONES
    if signal in ("AWLEN", "ARLEN"):
        return _ZERO
    if signal == "WLAST" and "AWLEN" not in have:
        return _ONES
    if channel and signal.endswith("BURST") and f"{channel}LEN" not in have:
        return _ZERO  # single beats: the burst type is irrelevant
    return Missing(refusal=f"drives no {signal}, which has no safe default")


def _slave_output(signal: str) -> Missing:
    if signal in ("BRESP", "RRESP"):
        return Missing(0, note=f"has no {signal}: every access reads as OKAY")
    if signal in _USERS:
        return _ZERO
    if signal in (*_WRITE, *_READ):
        half = "write" if signal in _WRITE else "read"
        return Missing(refusal=f"has no {half} channels ({signal}): an access from software would hang the bus")
    return Missing(refusal=f"drives no {signal}, which the region's other modules do")


def _master_input(signal: str, have: set[str]) -> Missing:
    if _absent_half(signal, have) or signal in (*_USERS, "RLAST"):
        return Missing()
    if signal in ("BRESP", "RRESP"):
        return Missing(note=f"does not read {signal}: it does not see bus errors")
    if signal in ("BID", "RID") and ("AWID" if signal == "BID" else "ARID") not in have:
        return Missing()
    return Missing(refusal=f"does not read {signal}")


def _slave_input(signal: str) -> Missing:
    if signal in (*_HINTS, *_USERS, "WLAST"):
        return Missing()
    if signal == "WSTRB":
        return Missing(note="does not read WSTRB: write whole words only")
    if signal in ("AWSIZE", "ARSIZE"):
        return Missing(note=f"does not read {signal}: access whole words only")
    return Missing(refusal=f"does not read {signal}")


def _absent_half(signal: str, have: set[str]) -> bool:
    """Whether the signal belongs to channels of which the module has none."""
    write = signal.startswith(("AW", "W", "B"))
    return ("AWVALID" if write else "ARVALID") not in have
