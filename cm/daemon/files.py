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
from cm.manager.ports import Image
from cm.schema.files import bitstream_path, find_file, overlay_path
from cm.schema.model import Config, FrameRange, Module, Overlay

_FIRMWARE = Path("lib/firmware")
_CONVERTED = "cm-converted"


class BoardFiles:
    """`cm.manager.ports.Files` over the file system below a root.

    Used by the worker and by plans that are made beside it, so the cache has a lock.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._cache = ReportCache()
        self._learned: dict[tuple[str, str], tuple[FrameRange, ...]] = {}

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
            raise Sha256Mismatch(f"{image.path}: the file was replaced after it had been checked; ask again")
        return read.data

    def port_bytes(self, image: Image) -> bytes:
        """Words in the order a DMA-fed port takes them. Raises Sha256Mismatch if the file changed since."""
        return to_dma_words(self._read(image))

    def firmware_name(self, image: Image) -> str:
        """The image as a word-swapped .bin below lib/firmware; made there if it lies elsewhere or has another form."""
        firmware = self._root / _FIRMWARE
        if image.report.container is Container.BIN_SWAPPED and image.path.is_relative_to(firmware):
            return str(image.path.relative_to(firmware))
        target = firmware / _CONVERTED / f"{image.sha256}.bin"
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            new = target.with_suffix(".new")
            new.write_bytes(convert(self._read(image), Container.BIN_SWAPPED))
            new.replace(target)
        return str(target.relative_to(firmware))

    def overlay(self, config: Config, overlay: Overlay) -> bytes:
        """The .dtbo's bytes."""
        return overlay_path(config, overlay, self._root).read_bytes()

    def loading_overlay(self, config: Config, module: Module) -> bytes:
        """The .dtbo by which a module is loaded through its fpga-region."""
        return find_file(config, [f"{module.name}.dtbo"], self._root).read_bytes()
