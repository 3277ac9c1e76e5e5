# SPDX-License-Identifier: Apache-2.0
"""Footprints of regions as learned from their modules, kept across restarts.

What is kept is worth no more than the bitstream it was learned from: where that module's file is not the
same any more (a new build, another floorplan), the footprint is learned anew.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.schema.model import Config, FrameRange

_LOG = logging.getLogger("cm")
_VERSION = 1

Frames = tuple[FrameRange, ...]
_Key = tuple[str, str]  # configuration, region


@dataclass(frozen=True, slots=True)
class Lesson:
    """A region's frames, and the module and bitstream that showed them."""

    module: str
    sha256: str
    frames: Frames


class Footprints:
    """Lessons by configuration and region; in a file of their own, if a path is given. Any thread."""

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._lessons: dict[_Key, Lesson] = dict(_read(path)) if path is not None else {}
        self._untested = set(self._lessons)  # of an earlier run

    def of(self, config: Config, region: str, sha256_of: Callable[[str], str | None]) -> Frames:
        """What was learned of a region; empty where nothing was.

        `sha256_of` tells the hash of a module's bitstream now, None where it has none.
        """
        key = (config.name, region)
        lesson = self._lessons.get(key)
        if lesson is None:
            return ()
        if key in self._untested and not _holds(lesson, config, region, sha256_of):
            self._drop([key])
            return ()
        self._untested.discard(key)
        return lesson.frames

    def learn(self, config: str, region: str, lesson: Lesson) -> None:
        """Keep the first lesson of a region."""
        with self._lock:
            if (config, region) not in self._lessons:
                self._lessons = {**self._lessons, (config, region): lesson}
                self._save()

    def forget(self, config: str) -> None:
        """The configuration was replaced: its regions may lie elsewhere now."""
        self._drop([key for key in self._lessons if key[0] == config])

    def _drop(self, keys: list[_Key]) -> None:
        with self._lock:
            if keys:
                self._lessons = {key: lesson for key, lesson in self._lessons.items() if key not in keys}
                self._untested.difference_update(keys)
                self._save()

    def _save(self) -> None:
        """What cannot be written is learned again after a restart."""
        if self._path is None:
            return
        try:
            _write(self._path, _encode(self._lessons))
        except OSError as error:
            _LOG.warning("learned footprints could not be written: %s", error)


def _holds(lesson: Lesson, config: Config, region: str, sha256_of: Callable[[str], str | None]) -> bool:
    module = config.modules.get(lesson.module)
    return module is not None and module.region == region and sha256_of(lesson.module) == lesson.sha256


def _write(path: Path, data: bytes) -> None:
    """In place of the file at once, also after a loss of power."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_suffix(".new")
    with new.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def _encode(lessons: Mapping[_Key, Lesson]) -> bytes:
    rows = [[*key, x.module, x.sha256, [_row(f) for f in x.frames]] for key, x in lessons.items()]
    body = json.dumps({"version": _VERSION, "regions": rows})
    return f"{zlib.crc32(body.encode()):08x} {body}\n".encode()


def _row(f: FrameRange) -> list[int]:
    return [f.block_type, f.row, f.column_first, f.column_last]


def _read(path: Path) -> Mapping[_Key, Lesson]:
    """What is in the file; nothing where it is missing, damaged or of another version."""
    try:
        return _decode(path.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        _LOG.warning("learned footprints in %s are not used (%s); they are learned anew", path, error)
        return {}


def _decode(data: bytes) -> Mapping[_Key, Lesson]:
    crc, _, body = data.strip().partition(b" ")
    if int(crc, 16) != zlib.crc32(body):
        raise ValueError("wrong CRC")
    plain: dict[str, Any] = json.loads(body)
    if plain["version"] != _VERSION:
        raise ValueError(f"version {plain['version']}")
    return {(c, r): Lesson(m, h, tuple(FrameRange(*map(int, f)) for f in fs)) for c, r, m, h, fs in plain["regions"]}
