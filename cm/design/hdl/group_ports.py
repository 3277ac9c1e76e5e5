# SPDX-License-Identifier: Apache-2.0
"""Groups ports by name into candidates for one bus: `s_axi_awaddr`, `M_AXIS_0_tdata`, `i_axi_awvalid`, `tdata_i`.

A port name is prefix, signal, tail. Ports of one bus share prefix and tail, except for an affix that only
shows the port's direction (`i_`, `_o`); it is ignored if it does so for every port of the group.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping

from cm.design.hdl.axi_signals import Protocol
from cm.design.hdl.model import Port, PortDirection
from cm.frozen import dataclass

_LEADING = re.compile(r"^(i|in|o|out)_", re.IGNORECASE)
_INFIX = re.compile(r"(?<=.)_(i|in|o|out)_$", re.IGNORECASE)  # s_axis_i_tdata beside s_axis_o_tready
_TRAILING = re.compile(r"_(i|in|o|out)$", re.IGNORECASE)


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
        found = (_LEADING.match(self.prefix), _INFIX.search(self.prefix), _TRAILING.search(self.tail))
        agrees = all(match is None or self._agrees(match[1]) for match in found)
        prefix = _INFIX.sub("_", _LEADING.sub("", self.key[0], count=1))
        return (prefix, _TRAILING.sub("", self.key[1])), agrees

    def _agrees(self, affix: str) -> bool:
        return (self.port.direction is PortDirection.IN) == affix.lower().startswith("i")


@dataclass(frozen=True, slots=True)
class Candidate:
    """Ports that, by their names, make up one bus of a protocol; nothing is checked yet."""

    name: str
    protocol: Protocol
    ports: Mapping[str, Port]  # logical signal name → port


def candidates(ports: Iterable[Port], protocol: Protocol) -> Iterator[Candidate]:
    """Candidates for buses of this protocol, in the order of their first ports."""
    named = [found for port in ports if (found := _split(port, protocol)) is not None]
    groups: dict[tuple[str, str], list[_Named]] = {}
    agreeing: dict[tuple[str, str], bool] = {}
    for item in named:
        key, agrees = item.bare()
        groups.setdefault(key, []).append(item)
        agreeing[key] = agreeing.get(key, True) and agrees
    for (prefix, tail), group in groups.items():
        if len({item.signal for item in group}) == len(group) and agreeing[prefix, tail]:
            yield _candidate(group, prefix + tail, protocol)
        else:
            yield from _split_group(group, protocol)


def _split_group(group: list[_Named], protocol: Protocol) -> Iterator[Candidate]:
    """Split a group by its affixes; if signals still occur twice, by the case of the names."""
    exact: dict[tuple[str, str], list[_Named]] = {}
    for item in group:
        exact.setdefault(item.key, []).append(item)
    for (prefix, tail), items in exact.items():
        if len({item.signal for item in items}) == len(items):
            yield _candidate(items, prefix + tail, protocol)
            continue
        cases: dict[str, list[_Named]] = {}
        for item in items:
            cases.setdefault(item.prefix + item.tail, []).append(item)
        for name, some in cases.items():
            yield _candidate(some, name, protocol)


def _candidate(group: list[_Named], bare: str, protocol: Protocol) -> Candidate:
    spelled = group[0].prefix + group[0].tail
    one = len({(item.prefix, item.tail) for item in group}) == 1 and _INFIX.search(group[0].prefix)
    name = spelled if one or spelled.lower() == bare.lower() else bare
    return Candidate(name.strip("_"), protocol, {item.signal: item.port for item in group})


def _split(port: Port, protocol: Protocol) -> _Named | None:
    match = protocol.pattern.fullmatch(port.name.strip("\\ "))
    if match is None or not _boundary(match["prefix"], match["signal"]):
        return None
    prefix = match["prefix"]
    return _Named(
        port, protocol.spelled[match["signal"].lower()], prefix.rstrip("_") + "_" if prefix else "", match["tail"]
    )


def _boundary(prefix: str, signal: str) -> bool:
    """Whether the signal begins a word: after `_`, at the start, or with a capital after a small letter or digit."""
    if not prefix or prefix.endswith("_"):
        return True
    return signal[0].isupper() and (prefix[-1].islower() or prefix[-1].isdigit())
