# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays for the manager: found, validated once per content, converted for the port."""

from __future__ import annotations

import threading
from pathlib import Path

from cm.bitstream import (
    Container,
    Expectation,
    ReportCache,
    convert,
    footprint_of,
    to_dma_words,
    verify,
)
from cm.bitstream.errors import BitstreamError, Sha256Mismatch
from cm.daemon.overlays import checked_overlay, firmware_names
from cm.manager.errors import BadOverlay
from cm.manager.ports import Image
from cm.schema.files import bitstream_path, find_file, overlay_path
from cm.schema.model import Config, FrameRange, Module, Overlay

_FIRMWARE = Path("lib/firmware")
_CONVERTED = "cm-converted"
_COPIES = 64


class BoardFiles:
    """`cm.manager.ports.Files` over the file system below a root.

    Used by the worker and by plans that are made beside it, so the cache has a lock.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._cache = ReportCache()
        self._learned: dict[tuple[str, str], tuple[FrameRange, ...]] = {}
        self._overlays: dict[Path, tuple[tuple[object, ...], bytes]] = {}
        self._same: set[tuple[str, str]] = set()  # firmware and image with the same words, by their hashes

    def image(self, config: Config, module: Module) -> Image:
        """Find and validate a module's bitstream.

        Raises FileMissing and the refusals of `cm.bitstream`. The footprint allowed is the schema's, or
        that of the first good module of the region.
        """
        region = config.regions[module.region]
        expect = Expectation(
            device=config.device,
            partial=True,
            footprint=region.footprint or self._learned.get((config.name, region.name), ()),
            allow_encrypted=region.allow_encrypted,
            sha256=module.sha256,
        )
        image = self._validated(bitstream_path(config, module, self._root), expect)
        if not region.footprint:
            self._learned.setdefault((config.name, region.name), footprint_of(image.report))
        return image

    def static_image(self, config: Config) -> Image:
        """Find and validate the image of a full configuration."""
        expect = Expectation(
            device=config.device, partial=False, allow_encrypted=config.allow_encrypted, sha256=config.sha256
        )
        return self._validated(bitstream_path(config, None, self._root), expect)

    def _validated(self, path: Path, expect: Expectation) -> Image:
        with self._lock:
            report = self._cache.inspect(path)
        try:
            verify(report, expect)
        except BitstreamError as error:
            raise type(error)(f"{path}: {error}") from error
        return Image(path, report.sha256, report.length, report)

    def _read(self, image: Image) -> bytes:
        """The bytes that were validated. Raises Sha256Mismatch if the file has other ones by now."""
        with self._lock:
            read = self._cache.read(image.path)
        if read.report.sha256 != image.sha256:
            raise _replaced(image)
        return read.data

    def _check_unchanged(self, image: Image) -> None:
        with self._lock:
            found = self._cache.inspect(image.path)
        if found.sha256 != image.sha256:
            raise _replaced(image)

    def port_bytes(self, image: Image) -> bytes:
        """Words in the order a DMA-fed port takes them. Raises Sha256Mismatch if the file changed since."""
        return to_dma_words(self._read(image))

    def firmware_name(self, image: Image) -> str:
        """The image as a word-swapped .bin below lib/firmware.

        The kernel reads the file itself. What does not lie there in that form is copied, under the hash
        of the bytes that were validated. Raises Sha256Mismatch if the file changed since.
        """
        firmware = self._root / _FIRMWARE
        if image.report.container is Container.BIN_SWAPPED and image.path.is_relative_to(firmware):
            self._check_unchanged(image)
            return str(image.path.relative_to(firmware))
        target = firmware / _CONVERTED / f"{image.sha256}.bin"
        if target.exists():
            target.touch()
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            new = target.with_suffix(".new")
            new.write_bytes(convert(self._read(image), Container.BIN_SWAPPED))
            new.replace(target)
            _prune(target.parent)
        return str(target.relative_to(firmware))

    def overlay(self, config: Config, overlay: Overlay) -> bytes:
        """The .dtbo's bytes. Raises FileMissing, BadOverlay."""
        return self._overlay(overlay_path(config, overlay, self._root))

    def loading_overlay(self, config: Config, module: Module, image: Image) -> bytes:
        """The .dtbo by which a module is loaded through its fpga-region.

        Raises FileMissing, and BadOverlay where the firmware it names has other words than the image that
        was validated: the kernel would load that.
        """
        path = find_file(config, [f"{module.name}.dtbo"], self._root)
        data = self._overlay(path)
        names = firmware_names(str(path), data)
        if len(names) != 1:
            raise BadOverlay(f"{path}: one firmware-name is expected, there are {len(names)}")
        self._check_firmware(path, names[0], image)
        return data

    def forget(self, config: str) -> None:
        """Its files were replaced: its regions may lie elsewhere now."""
        self._learned = {key: frames for key, frames in self._learned.items() if key[0] != config}

    def _overlay(self, path: Path) -> bytes:
        state = path.stat()
        key = (path, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        found = self._overlays.get(path)
        if found is not None and found[0] == key:
            return found[1]
        data = checked_overlay(str(path), self._read_overlay(path))
        self._overlays[path] = (key, data)
        return data

    def _read_overlay(self, path: Path) -> bytes:
        return path.read_bytes()

    def _check_firmware(self, overlay: Path, name: str, image: Image) -> None:
        place = self._root / _FIRMWARE / name
        try:
            with self._lock:
                there = self._cache.inspect(place).sha256
        except OSError as error:
            raise BadOverlay(f"{overlay}: its firmware-name {name!r} cannot be read ({error})") from error
        if (there, image.sha256) in self._same:
            return
        if there != image.sha256 and to_dma_words(place) != to_dma_words(self._read(image)):
            raise BadOverlay(f"{overlay}: its firmware-name {name!r} is another bitstream than {image.path}")
        self._same.add((there, image.sha256))


def _replaced(image: Image) -> Sha256Mismatch:
    return Sha256Mismatch(f"{image.path}: the file was replaced after it had been checked; ask again")


def _prune(folder: Path) -> None:
    """Keep the copies used last: others are made again when they are needed."""
    copies = sorted(folder.glob("*.bin"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
    for old in copies[_COPIES:]:
        old.unlink(missing_ok=True)
