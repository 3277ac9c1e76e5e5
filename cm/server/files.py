# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays of a configuration: found, validated once per content, with the footprints they reveal.

A learned footprint is valid only as long as the bitstream it was learned from: if that module's file has changed (a
new build, another floorplan), it is learned again.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.errors import CmError
from cm.formats.bitstream import expect_module, expect_static, footprint_of, to_dma_words
from cm.manager.interfaces import Image
from cm.schema.files import bitstream_path
from cm.schema.model import Config, FrameRange, Module, Overlay, Region
from cm.server.images import BitstreamReader, FirmwareFolder, image_of
from cm.server.overlay_files import OverlayFiles

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
        self._learned: dict[_Key, LearnedFootprint] = dict(_read(path)) if path is not None else {}
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
            _write(self._path, _encode(self._learned))
        except OSError as error:
            _LOG.warning("learned footprints could not be written: %s", error)


def _holds(learned: LearnedFootprint, config: Config, region: str, sha256_of: Callable[[str], str | None]) -> bool:
    module = config.modules.get(learned.module)
    return module is not None and module.region == region and sha256_of(learned.module) == learned.sha256


def _write(path: Path, data: bytes) -> None:
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


def _read(path: Path) -> Mapping[_Key, LearnedFootprint]:
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


class BoardFiles:
    """`cm.manager.interfaces.Files` over the file system below a root."""

    def __init__(self, root: Path, footprints: Footprints | None = None, copies: Path | None = None) -> None:
        """`copies`: the folder for files converted for the kernel, see `FirmwareFolder`."""
        self._root = root
        self._reader = BitstreamReader()
        self._firmware = FirmwareFolder(root, self._reader, copies)
        self._footprints = footprints or Footprints()
        self._overlays = OverlayFiles(root, self._reader, self._firmware, self._read_overlay)

    # ---- bitstreams -----------------------------------------------------------------

    def image(self, config: Config, module: Module) -> Image:
        """Find and validate a module's bitstream.

        Raises FileMissing and the refusals of `cm.formats.bitstream`. The footprint allowed is the schema's, or
        that of the first good module of the region.
        """
        region = config.regions[module.region]
        learned = () if region.footprint else self._learned(config, region)
        expect = expect_module(config, module, learned)
        path = bitstream_path(config, module, self._root)
        report = self._reader.validated(path, expect)
        if not (region.footprint or learned):
            shown = LearnedFootprint(module.name, report.sha256, footprint_of(report))
            self._footprints.learn(config.name, region.name, shown)
        return image_of(path, report)

    def _learned(self, config: Config, region: Region) -> Frames:
        def sha256_of(module: str) -> str | None:
            try:
                return self._reader.inspect(bitstream_path(config, module, self._root)).sha256
            except (CmError, OSError):
                return None

        return self._footprints.of(config, region.name, sha256_of)

    def static_image(self, config: Config) -> Image:
        """Find and validate the image of a full configuration."""
        path = bitstream_path(config, None, self._root)
        return image_of(path, self._reader.validated(path, expect_static(config)))

    def port_bytes(self, image: Image) -> bytes:
        """Words in the order a DMA-fed port takes them. Raises Sha256Mismatch if the file changed since."""
        return to_dma_words(self._reader.read(image))

    def forget(self, config: str) -> None:
        """This configuration was replaced: its footprints are learned anew."""
        self._footprints.forget(config)

    # ---- what the kernel is given ---------------------------------------------------

    def firmware_name(self, image: Image) -> str:
        """See `FirmwareFolder.name_of`."""
        return self._firmware.name_of(image)

    def check_firmware(self, name: str, image: Image) -> None:
        """See `FirmwareFolder.check`."""
        self._firmware.check(name, image)

    def overlay(self, config: Config, overlay: Overlay, images: Sequence[Image]) -> bytes:
        """See `OverlayFiles.beside`."""
        return self._overlays.beside(config, overlay, images)

    def loading_overlay(self, config: Config, module: Module, image: Image) -> bytes:
        """See `OverlayFiles.loading`."""
        return self._overlays.loading(config, module, image)

    def _read_overlay(self, path: Path) -> bytes:
        return path.read_bytes()
