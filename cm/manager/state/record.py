# SPDX-License-Identifier: Apache-2.0
"""The record of what the hardware holds and how long steps took, as data and as a line of JSON with a CRC."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from cm.manager.state.table import BoardState, OverlayState, RegionPhase, RegionState
from cm.schema.model import LoaderKind, Region

# Before anything was measured: facts of the ports (UG470 32 bit × 100 MHz; zynq-fpga over PCAP).
_NOMINAL = {LoaderKind.ICAP: 400e6, LoaderKind.FPGA_MANAGER: 145e6, LoaderKind.OVERLAY: 145e6}
_MARGIN = 20.0  # a load may take this many times what is expected before it counts as hung
_GRACE = 2.0  # seconds that any load may take
_RECENT = 5  # measurements of a kind that count

_VERSION = 2
_json = json.JSONEncoder(separators=(",", ":")).encode


@dataclass(frozen=True, slots=True)
class Throughput:
    """What was measured, the last few of each kind, the newest last.

    `measured` are bytes per second of the ports, by kind of loader. `steps` are seconds by kind of step
    (`cm.manager.state.steps`) beside what a port takes for an image: reading files, the kernel's drivers, the
    record. What is expected is their median: a single one that was disturbed, as the first after a start is by cold
    caches, says nothing about the next. Of two, the quicker counts, and beside a single load the port's nominal rate.
    """

    measured: Mapping[LoaderKind, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))
    steps: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))

    def rate(self, loader: LoaderKind) -> float:
        """Bytes per second to expect."""
        rates = self.measured.get(loader, ())
        known = sorted(rates if len(rates) > 1 else (*rates, _NOMINAL[loader]))
        return known[len(known) // 2]

    def seconds(self, loader: LoaderKind, length: int) -> float:
        """Expected duration of a load of `length` bytes."""
        return length / self.rate(loader)

    def overhead(self, step: str) -> float:
        """Expected seconds of a kind of step beside the port; 0 before it was measured."""
        known = sorted(self.steps.get(step) or (0.0,))
        return known[(len(known) - 1) // 2]

    def timeout(self, region: Region, length: int) -> float:
        """Seconds after which a load counts as hung: the schema's, else from size and throughput."""
        if region.timeout is not None:
            return region.timeout
        return _GRACE + _MARGIN * self.seconds(region.loader, length)

    def observed(self, loader: LoaderKind, length: int, seconds: float) -> Throughput:
        """With one more load."""
        if seconds <= 0 or length <= 0:
            return self
        rates = _with(self.measured.get(loader, ()), length / seconds)
        return replace(self, measured=MappingProxyType({**self.measured, loader: rates}))

    def took(self, step: str, seconds: float) -> Throughput:
        """With one more step, without the time of the port in it."""
        return replace(self, steps=MappingProxyType({**self.steps, step: _with(self.steps.get(step, ()), seconds)}))


def _with(before: tuple[float, ...], new: float) -> tuple[float, ...]:
    return (*before, float(f"{new:.4g}"))[-_RECENT:]  # recorded before every step, so without digits that mean nothing


@dataclass(frozen=True, slots=True)
class Pending:
    """A change under way: where it goes, where it came from, and the step it was about to take."""

    number: int
    config: str
    mode: str
    from_config: str | None
    from_mode: str | None
    step: str = ""
    subject: str = ""
    overlay: str | None = None  # being applied or removed
    from_static: str | None = None  # the full configuration whose image the device held
    held: Mapping[str, str] = field(default_factory=dict)  # modules of the regions that were ready before it
    values: Mapping[str, int] = field(default_factory=dict)  # registers as they were before it, for the way back
    found: tuple[tuple[int, int, int], ...] = ()  # others: physical address, width and value
    rates: Mapping[str, int] = field(default_factory=dict)  # clocks, in Hz, likewise


@dataclass(frozen=True, slots=True)
class WayBack:
    """What it takes to undo the last change: who asked for that gave it the name."""

    name: str
    change: Pending


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the journal."""

    boot_id: str
    state: BoardState
    pending: Pending | None = None
    throughput: Throughput = field(default_factory=Throughput)
    number: int = 0  # of the last change
    way_back: WayBack | None = None


class OtherVersion(ValueError):
    """A whole line that another version of this program wrote."""


def encode(record: Record) -> bytes:
    """A line; it begins with a line end, so that a torn line before it does no harm."""
    plain = _json(_to_plain(record))
    rates = ",".join([_measured(kind.value, rates) for kind, rates in record.throughput.measured.items()])
    seconds = ",".join([_measured(kind, took) for kind, took in record.throughput.steps.items()])
    body = f'{plain[:-1]},"throughput":{{{rates}}},"seconds":{{{seconds}}}}}'.encode()
    return b"\n%08x %b\n" % (zlib.crc32(body), body)


@lru_cache(64)
def _measured(kind: str, values: tuple[float, ...]) -> str:
    """Measurements of a kind.

    Cached, as few are new in each record, and formatting all would take longer than the rest of it.
    """
    return f"{_json(kind)}:{_json(values)}"


def newest(data: bytes) -> Record | None:
    """The last whole line; None where there is none.

    Raises OtherVersion: the newest whole line counts, or none, as those before it are no longer true.
    """
    for line in reversed(data.split(b"\n")):
        body = _checked(line)
        if body is not None:
            return _understood(body)
    return None


def _checked(line: bytes) -> bytes | None:
    """The body of a line whose CRC is right."""
    crc, space, body = line.partition(b" ")
    try:
        return body if space and int(crc, 16) == zlib.crc32(body) else None
    except ValueError:
        return None


def _understood(body: bytes) -> Record:
    try:
        return _from_plain(json.loads(body))
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise OtherVersion(str(error)) from None


def _to_plain(r: Record) -> dict[str, Any]:
    """All but what was measured."""
    return {
        "version": _VERSION,
        "boot_id": r.boot_id,
        "number": r.number,
        "state": {
            "config": r.state.config,
            "mode": r.state.mode,
            "static": [r.state.static_sha256, r.state.static_config, r.state.static_lost],
            "regions": {n: [x.phase.value, x.module, x.sha256] for n, x in r.state.regions.items()},
            "overlays": [[o.name, o.sha256] for o in r.state.overlays],
            "values": dict(r.state.values),
            "clocks": dict(r.state.clocks),
        },
        "pending": None if r.pending is None else _pending_to_plain(r.pending),
        **({"way_back": [r.way_back.name, _pending_to_plain(r.way_back.change)]} if r.way_back else {}),
    }


def _pending_to_plain(pending: Pending) -> dict[str, Any]:
    plain = {name: getattr(pending, name) for name in Pending.__slots__}
    return {**plain, "held": dict(pending.held), "values": dict(pending.values), "rates": dict(pending.rates)}


def _pending_from_plain(plain: Mapping[str, Any]) -> Pending:
    return Pending(**{**plain, "found": tuple((int(a), int(w), int(v)) for a, w, v in plain.get("found", ()))})


def _from_plain(plain: Mapping[str, Any]) -> Record:
    """Raises ValueError, KeyError, TypeError, IndexError or AttributeError for what is not of this version.

    "seconds", "clocks" and what is pending beyond its step came later; what an older program wrote has none.
    """
    if plain["version"] != _VERSION:
        raise ValueError(plain["version"])
    state = plain["state"]
    back = plain.get("way_back")
    return Record(
        boot_id=plain["boot_id"],
        number=plain["number"],
        state=BoardState(
            config=state["config"],
            mode=state["mode"],
            static_sha256=state["static"][0],
            static_config=state["static"][1],
            static_lost=state["static"][2],
            regions=MappingProxyType(
                {n: RegionState(RegionPhase(p), m, h) for n, (p, m, h) in state["regions"].items()}
            ),
            overlays=tuple(OverlayState(n, h) for n, h in state["overlays"]),
            values=MappingProxyType(dict(state["values"])),
            clocks=MappingProxyType(dict(state.get("clocks", {}))),
        ),
        pending=None if plain["pending"] is None else _pending_from_plain(plain["pending"]),
        throughput=Throughput(
            MappingProxyType({LoaderKind(k): _several(v) for k, v in plain["throughput"].items()}),
            MappingProxyType({str(k): _several(v) for k, v in plain.get("seconds", {}).items()}),
        ),
        way_back=None if back is None else WayBack(back[0], _pending_from_plain(back[1])),
    )


def _several(plain: float | list[float]) -> tuple[float, ...]:
    """Measurements; older programs wrote their mean."""
    return tuple(map(float, plain)) if isinstance(plain, list) else (float(plain),)
