# SPDX-License-Identifier: Apache-2.0
"""The record of what the hardware holds: written before each step, read after a crash.

A journal of one JSON line per record, each with a CRC; the last whole line counts. Appending one
line is a single write(2), so a killed manager leaves whole lines and at most one torn end. There is
no fsync: after a loss of power the device is empty too, and the boot id tells so. The journal is
replaced atomically (rename) by its last line when it has grown.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.manager.cost import Throughput
from cm.manager.errors import StoreCorrupt
from cm.manager.state import BoardState, OverlayState, RegionPhase, RegionState
from cm.schema.model import LoaderKind

_VERSION = 2
_ROTATE = 256 * 1024  # bytes


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


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the journal."""

    boot_id: str
    state: BoardState
    pending: Pending | None = None
    throughput: Throughput = field(default_factory=Throughput)
    number: int = 0  # of the last change


class Store:
    """The journal in a folder. One manager owns it (the daemon holds a lock on the runtime folder)."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / "journal"
        self._fd = self._open()

    def _open(self) -> int:
        return os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o640)

    def write(self, record: Record) -> None:
        """Append a record; it survives the death of this process from here on. Raises OSError."""
        line = _encode(record)
        if os.fstat(self._fd).st_size + len(line) > _ROTATE:
            self._rotate(line)
            return
        written = os.write(self._fd, line)
        if written != len(line):
            raise OSError(28, f"state record {self._path} could not be written whole: is the disk full?")

    def read(self) -> Record | None:
        """The last whole record; None if there is none yet.

        Raises StoreCorrupt where the file holds lines but no good one, or the last good one is of
        another version; it is set aside first.
        """
        data = self._path.read_bytes()
        for line in reversed(data.split(b"\n")):
            body = _checked(line)
            if body is not None:
                return self._understood(body)
        if data.strip():
            raise StoreCorrupt(f"the state record {self._path} holds no whole line; it was moved to {self._aside()}")
        return None

    def _understood(self, body: bytes) -> Record:
        """The newest whole line counts, or none: those before it are no longer true."""
        try:
            return _from_plain(json.loads(body))
        except (ValueError, KeyError, TypeError, AttributeError, IndexError):
            raise StoreCorrupt(
                f"the state record {self._path} is of another version of this program; it was moved to {self._aside()}"
            ) from None

    def _aside(self) -> Path:
        aside = self._path.with_suffix(".corrupt")
        self._path.replace(aside)
        os.close(self._fd)
        self._fd = self._open()
        return aside

    def _rotate(self, line: bytes) -> None:
        new = self._path.with_suffix(".new")
        new.write_bytes(line)
        new.replace(self._path)
        os.close(self._fd)
        self._fd = self._open()

    def close(self) -> None:
        """Close the file; twice is fine."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def _encode(record: Record) -> bytes:
    body = json.dumps(_to_plain(record), separators=(",", ":")).encode()
    return b"\n%08x %b\n" % (zlib.crc32(body), body)


def _checked(line: bytes) -> bytes | None:
    """The body of a line whose CRC is right."""
    crc, space, body = line.partition(b" ")
    try:
        return body if space and int(crc, 16) == zlib.crc32(body) else None
    except ValueError:
        return None


def _to_plain(r: Record) -> dict[str, Any]:
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
        },
        "pending": None if r.pending is None else {n: getattr(r.pending, n) for n in Pending.__slots__},
        "throughput": {kind.value: rate for kind, rate in r.throughput.measured.items()},
    }


def _from_plain(plain: Mapping[str, Any]) -> Record:
    """Raises ValueError, KeyError, TypeError, IndexError or AttributeError for what is not of this version."""
    if plain["version"] != _VERSION:
        raise ValueError(plain["version"])
    state = plain["state"]
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
        ),
        pending=None if plain["pending"] is None else Pending(**plain["pending"]),
        throughput=Throughput(MappingProxyType({LoaderKind(k): float(v) for k, v in plain["throughput"].items()})),
    )
