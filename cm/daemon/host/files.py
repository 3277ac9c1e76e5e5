# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays for the manager: found, validated once per content, converted for the port."""

from __future__ import annotations

from pathlib import Path

from cm.bitstream import expect_module, expect_static, footprint_of, to_dma_words
from cm.daemon.host.bitstreams import BitstreamReader, image_of
from cm.daemon.host.firmware import FirmwareFolder
from cm.daemon.host.footprints import Footprints, Frames, Lesson
from cm.daemon.host.overlay_files import OverlayFiles
from cm.errors import CmError
from cm.manager.ports import Image
from cm.schema.files import bitstream_path
from cm.schema.model import Config, Module, Region


class BoardFiles:
    """`cm.manager.ports.Files` over the file system below a root."""

    def __init__(self, root: Path, footprints: Footprints | None = None, copies: Path | None = None) -> None:
        """`copies`: the folder for what is converted for the kernel, see `FirmwareFolder`."""
        self._root = root
        self._reader = BitstreamReader()
        self._firmware = FirmwareFolder(root, self._reader, copies)
        self._footprints = footprints or Footprints()
        overlays = OverlayFiles(root, self._reader, self._firmware, self._read_overlay)
        self.overlay = overlays.beside
        self.loading_overlay = overlays.loading
        self.firmware_name = self._firmware.name_of
        self.check_firmware = self._firmware.check
        self.forget = self._footprints.forget

    # ---- bitstreams -----------------------------------------------------------------

    def image(self, config: Config, module: Module) -> Image:
        """Find and validate a module's bitstream.

        Raises FileMissing and the refusals of `cm.bitstream`. The footprint allowed is the schema's, or
        that of the first good module of the region.
        """
        region = config.regions[module.region]
        learned = () if region.footprint else self._learned(config, region)
        expect = expect_module(config, module, learned)
        path = bitstream_path(config, module, self._root)
        report = self._reader.validated(path, expect)
        if not region.footprint:
            lesson = Lesson(module.name, report.sha256, footprint_of(report))
            self._footprints.learn(config.name, region.name, lesson)
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

    # ---- overlays -------------------------------------------------------------------

    def _read_overlay(self, path: Path) -> bytes:
        return path.read_bytes()
