# SPDX-License-Identifier: Apache-2.0
"""The frames of regions whose schema names none, learned from the first good module.

A learned footprint is valid only as long as the bitstream it was learned from: if that module's file has changed (a
new build, another floorplan), it is learned again.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cm.frozen import dataclass
from cm.schema.model import Config, FrameRange

_LOG = logging.getLogger("cm")
_VERSION = 1

Frames = tuple[FrameRange, ...]
_Key = tuple[str, str]  # configuration, region


@dataclass(frozen=True, slots=True)
class LearnedFootprint:
    """A region's frames, and the module and bitstream that showed them."""

    module: str
    sha256: str
    frames: Frames


class Footprints:
    """Learned footprints by configuration and region; in a file of their own, if a path is given. Any thread."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._learned: dict[_Key, LearnedFootprint] = dict(_read_learned(path)) if path is not None else {}
        self._untested = set(self._learned)  # of an earlier run

    def of(self, config: Config, region: str, sha256_of: Callable[[str], str | None]) -> Frames:
        """What was learned about a region; empty if nothing was.

        `sha256_of` returns the present hash of a module's bitstream, None if it has none.
        """
        key = (config.name, region)
        learned = self._learned.get(key)
        if learned is None:
            return ()
        if key in self._untested and not _holds(learned, config, region, sha256_of):
            self._drop([key])
            return ()
        self._untested.discard(key)
        return learned.frames

    def learn(self, config: str, region: str, learned: LearnedFootprint) -> None:
        """Keep the first footprint learned of a region."""
        with self._lock:
            if (config, region) not in self._learned:
                self._learned = {**self._learned, (config, region): learned}
                self._save()

    def forget(self, config: str) -> None:
        """The configuration was replaced: its regions may lie elsewhere now."""
        self._drop([key for key in self._learned if key[0] == config])

    def _drop(self, keys: list[_Key]) -> None:
        with self._lock:
            if keys:
                self._learned = {key: learned for key, learned in self._learned.items() if key not in keys}
                self._untested.difference_update(keys)
                self._save()

    def _save(self) -> None:
        """Save to the file; what cannot be written is learned again after a restart."""
        if self._path is None:
            return
        try:
            _write_learned(self._path, _encode(self._learned))
        except OSError as error:
            _LOG.warning("learned footprints could not be written: %s", error)


def _holds(learned: LearnedFootprint, config: Config, region: str, sha256_of: Callable[[str], str | None]) -> bool:
    module = config.modules.get(learned.module)
    return module is not None and module.region == region and sha256_of(learned.module) == learned.sha256


def _write_learned(path: Path, data: bytes) -> None:
    """Replace the file in one step, safe against a loss of power."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    with new.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def _encode(learned: Mapping[_Key, LearnedFootprint]) -> bytes:
    rows = [[*key, x.module, x.sha256, [_row(f) for f in x.frames]] for key, x in learned.items()]
    body = json.dumps({"version": _VERSION, "regions": rows})
    return f"{zlib.crc32(body.encode()):08x} {body}\n".encode()


def _row(f: FrameRange) -> list[int]:
    return [f.block_type, f.row, f.column_first, f.column_last]


def _read_learned(path: Path) -> Mapping[_Key, LearnedFootprint]:
    """The content of the file; nothing if it is missing, damaged or of another version."""
    try:
        return _decode(path.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        _LOG.warning("learned footprints in %s are not used (%s); they are learned anew", path, error)
        return {}


def _decode(data: bytes) -> Mapping[_Key, LearnedFootprint]:
    crc, _, body = data.strip().partition(b" ")
    if int(crc, 16) != zlib.crc32(body):
        raise ValueError("wrong CRC")
    plain: dict[str, Any] = json.loads(body)
    if plain["version"] != _VERSION:
        raise ValueError(f"version {plain['version']}")
    return {
        (c, r): LearnedFootprint(m, h, tuple(FrameRange(*map(int, f)) for f in fs))
        for c, r, m, h, fs in plain["regions"]
    }
