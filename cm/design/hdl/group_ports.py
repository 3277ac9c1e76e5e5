# SPDX-License-Identifier: Apache-2.0
"""Groups ports by name into candidates for one bus: `s_axi_awaddr`, `M_AXIS_0_tdata`, `i_axi_awvalid`, `tdata_i`.

Whatever separates the words: `sAxiAwaddr`, `cfg_aw_addr`, and bundles as Chisel, SpinalHDL and Amaranth write them,
`io_aw_bits_addr`, `io_aw_payload_addr`, `i__payload`.

A port name is prefix, signal, tail. Ports of one bus share prefix and tail, except for an affix that only
shows the port's direction (`i_`, `_o`); it is ignored if it does so for every port of the group.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache

from cm.design.hdl.axi_signals import Protocol
from cm.design.hdl.model import Port, PortDirection
from cm.frozen import dataclass, replace

_LEADING = re.compile(r"^(i|in|o|out)_", re.IGNORECASE)
_INFIX = re.compile(r"(?<=.)_(i|in|o|out)_$", re.IGNORECASE)  # s_axis_i_tdata beside s_axis_o_tready
_TRAILING = re.compile(r"_(i|in|o|out)$", re.IGNORECASE)
_GLUED = re.compile(r"([io])(\w+)")
_WAYS = frozenset(("i", "o", "in", "out"))
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")
_BUNDLE = re.compile(r"_+(?:bits|payload)(?:(_)|$)")
_LONGEST = 3  # words of a signal


@dataclass(frozen=True, slots=True)
class _Named:
    """A port whose name contains a signal of the protocol."""

    port: Port
    signal: str
    prefix: str
    tail: str

    @property
    def key(self) -> tuple[str, str]:
        return self.prefix.lower(), self.tail.lower()

    def bare(self) -> tuple[tuple[str, str], bool]:
        """The key without direction affixes, and whether those agree with the port's direction."""
        key, affixes = _bare(self.prefix, self.tail)
        wanted = "i" if self.port.direction is PortDirection.IN else "o"
        return key, all(affix == wanted for affix in affixes)


@dataclass(frozen=True, slots=True)
class Candidate:
    """Ports that, by their names, make up one bus of a protocol; nothing is checked yet."""

    name: str
    protocol: Protocol
    ports: Mapping[str, Port]  # logical signal name → port


def candidates(ports: Iterable[Port], protocol: Protocol) -> Iterator[Candidate]:
    """Candidates for buses of this protocol, in the order of their first ports."""
    named = _joined([found for port in ports if (found := _split(port, protocol)) is not None], protocol)
    groups: dict[tuple[str, str], list[_Named]] = {}
    agreeing: dict[tuple[str, str], bool] = {}
    for item in named:
        key, agrees = item.bare()
        groups.setdefault(key, []).append(item)
        agreeing[key] = agreeing.get(key, True) and agrees
    for (prefix, tail), group in groups.items():
        mirrors = _mirrors(group, protocol) if agreeing[prefix, tail] else ()
        if agreeing[prefix, tail] and _once(group):
            yield _candidate(group, prefix + tail, protocol)
        elif mirrors and all(map(_once, mirrors)):
            yield from (_candidate(side, None, protocol) for side in mirrors)
        else:
            yield from _split_group(group, protocol)


def _once(group: list[_Named]) -> bool:
    """Whether each signal occurs once."""
    return len({item.signal for item in group}) == len(group)


def _mirrors(group: list[_Named], protocol: Protocol) -> Sequence[list[_Named]]:
    """The sides of a slave and a master, `i_valid`, `o_ready` and `o_valid`, `i_ready`, by affixes of direction."""
    sides: tuple[list[_Named], list[_Named]] = ([], [])
    for item in group:
        sides[item.port.direction is protocol.signals[item.signal].direction].append(item)
    return sides if all(sides) and all(item.key != item.bare()[0] for item in group) else ()


def _joined(named: list[_Named], protocol: Protocol) -> list[_Named]:
    """Without a channel's name in front of each of its signals: `io_aw_awvalid`, but not in a bus called `io_aw`."""
    found: dict[str, set[str]] = {}
    for item in named:
        found.setdefault(item.prefix.lower(), set()).add(protocol.channels.get(item.signal, ""))
    twice = {prefix for prefix, channels in found.items() if len(channels) == 1 and _ends(prefix, *channels)}
    if len(twice) < 2:
        return named
    return [
        replace(item, prefix=item.prefix[: -len(protocol.channels[item.signal]) - 1])
        if item.prefix.lower() in twice
        else item
        for item in named
    ]


def _ends(prefix: str, channel: str) -> bool:
    return bool(channel) and f"_{prefix}".endswith(f"_{channel}_")


def _split_group(group: list[_Named], protocol: Protocol) -> Iterator[Candidate]:
    """Split a group by its affixes; if signals still occur twice, by the case of the names."""
    exact: dict[tuple[str, str], list[_Named]] = {}
    for item in group:
        exact.setdefault(item.key, []).append(item)
    for (prefix, tail), items in exact.items():
        if _once(items):
            yield _candidate(items, prefix + tail, protocol)
            continue
        cases: dict[str, list[_Named]] = {}
        for item in items:
            cases.setdefault(item.prefix + item.tail, []).append(item)
        for name, some in cases.items():
            yield _candidate(some, name, protocol)


def _candidate(group: list[_Named], bare: str | None, protocol: Protocol) -> Candidate:
    """The candidate with the name `bare`, or that of what the sender drives, as it is spelled."""
    sent = (item for item in group if protocol.signals[item.signal].direction is PortDirection.OUT)
    first = group[0] if bare is not None else next(sent, group[0])
    spelled = first.prefix + first.tail
    bare = spelled if bare is None else bare
    one = len({(item.prefix, item.tail) for item in group}) == 1 and _INFIX.search(group[0].prefix)
    name = spelled if one or not bare.strip("_") or spelled.lower() == bare.lower() else bare
    return Candidate(name.strip("_").replace("__", "_"), protocol, {item.signal: item.port for item in group})


@lru_cache(maxsize=1 << 12)
def _bare(prefix: str, tail: str) -> tuple[tuple[str, str], tuple[str, ...]]:
    """Prefix and tail without direction affixes, in lower case, and the first letters of those."""
    found = (_LEADING.match(prefix), _INFIX.search(prefix), _TRAILING.search(tail))
    bare = _INFIX.sub("_", _LEADING.sub("", prefix.lower(), count=1))
    return (bare, _TRAILING.sub("", tail.lower())), tuple(match[1][0].lower() for match in found if match)


def _split(port: Port, protocol: Protocol) -> _Named | None:
    found = _signal(port.name, protocol)
    return _Named(port, *found) if found else None


@lru_cache(maxsize=1 << 15)
def _signal(name: str, protocol: Protocol) -> tuple[str, str, str] | None:
    """The signal, the prefix and the tail of a port's name; the same names are in many modules."""
    found = _of(_words(name, False), protocol)
    if found is None and _CAMEL.search(name):
        found = _of(_words(name, True), protocol)
    if found is None and protocol.glued and (glued := _GLUED.fullmatch(name)):
        found = _of(_words(f"{glued[1]}_{glued[2]}", False), protocol)
    return found


@lru_cache(maxsize=256)
def _words(name: str, camel: bool) -> tuple[list[str], list[str], int]:
    """The words of a name, also in lower case, and how many there are before those of direction and numbers."""
    name = _CAMEL.sub("_", name.strip("\\ ")) if camel else name.strip("\\ ")
    if "__" in name or "bits" in name or "payload" in name:
        name = _BUNDLE.sub(lambda found: "_" if found[1] else "_data", name).replace("__", "_")
    words, low = name.split("_"), name.lower().split("_")
    end = len(words)
    while end > 1 and (low[end - 1] in _WAYS or low[end - 1].isdigit()):
        end -= 1
    return words, low, end


def _of(named: tuple[list[str], list[str], int], protocol: Protocol) -> tuple[str, str, str] | None:
    """Find the signal among the words of a name: the last ones, unless the protocol's are distinct."""
    words, low, end = named
    for stop in range(end, 0, -1) if protocol.distinct else (end,):
        if low[stop - 1] not in protocol.ends:
            continue
        for start in range(max(0, stop - _LONGEST), stop):
            signal = protocol.spelled.get("_".join(low[start:stop]))
            if signal is None:
                continue
            prefix = "_".join([*words[:start], ""]) if any(words[:start]) else ""
            if protocol.prefix is None or protocol.prefix.fullmatch(prefix):
                return signal, prefix, "".join(f"_{word}" for word in words[stop:])
    return None
