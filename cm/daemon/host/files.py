# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays for the manager: found, validated once per content, converted for the port."""

from __future__ import annotations

from pathlib import Path

from cm.bitstream import Expectation, footprint_of, to_dma_words
from cm.daemon.host.bitstreams import BitstreamReader
from cm.daemon.host.firmware import FirmwareFolder
from cm.daemon.host.footprints import Footprints, Frames, Lesson
from cm.daemon.host.overlays import checked_overlay, firmware_names
from cm.errors import CmError
from cm.manager.errors import BadOverlay
from cm.manager.ports import Image
from cm.schema.files import bitstream_path, find_file, overlay_path
from cm.schema.model import Config, Module, Overlay, Region

_MAX_OVERLAY = 16 << 20  # bytes


class BoardFiles:
    """`cm.manager.ports.Files` over the file system below a root."""

    def __init__(self, root: Path, footprints: Footprints | None = None) -> None:
        self._root = root
        self._reader = BitstreamReader()
        self._firmware = FirmwareFolder(root, self._reader)
        self._footprints = footprints or Footprints()
        self._overlays: dict[Path, tuple[tuple[object, ...], bytes]] = {}
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
        expect = Expectation(
            device=config.device,
            partial=True,
            footprint=region.footprint or self._learned(config, region),
            allow_encrypted=region.allow_encrypted,
            sha256=module.sha256,
        )
        image = self._reader.validated(bitstream_path(config, module, self._root), expect)
        if not region.footprint:
            lesson = Lesson(module.name, image.sha256, footprint_of(image.report))
            self._footprints.learn(config.name, region.name, lesson)
        return image

    def _learned(self, config: Config, region: Region) -> Frames:
        def sha256_of(module: str) -> str | None:
            try:
                return self._reader.inspect(bitstream_path(config, module, self._root)).sha256
            except (CmError, OSError):
                return None

        return self._footprints.of(config, region.name, sha256_of)

    def static_image(self, config: Config) -> Image:
        """Find and validate the image of a full configuration."""
        expect = Expectation(
            device=config.device, partial=False, allow_encrypted=config.allow_encrypted, sha256=config.sha256
        )
        return self._reader.validated(bitstream_path(config, None, self._root), expect)

    def port_bytes(self, image: Image) -> bytes:
        """Words in the order a DMA-fed port takes them. Raises Sha256Mismatch if the file changed since."""
        return to_dma_words(self._reader.read(image))

    # ---- overlays -------------------------------------------------------------------

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
        self._check_named(path, names[0], image)
        return data

    def _overlay(self, path: Path) -> bytes:
        state = path.stat()
        key = (path, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        found = self._overlays.get(path)
        if found is not None and found[0] == key:
            return found[1]
        if state.st_size > _MAX_OVERLAY:
            raise BadOverlay(f"{path}: {state.st_size} bytes are no overlay; at most {_MAX_OVERLAY >> 20} MiB are read")
        data = checked_overlay(str(path), self._read_overlay(path))
        self._overlays[path] = (key, data)
        return data

    def _read_overlay(self, path: Path) -> bytes:
        return path.read_bytes()

    def _check_named(self, overlay: Path, name: str, image: Image) -> None:
        try:
            same = self._reader.has_words_of(self._firmware.place(name), image)
        except (CmError, OSError) as error:
            raise BadOverlay(f"{overlay}: its firmware-name {name!r} cannot be used ({error})") from error
        if not same:
            raise BadOverlay(f"{overlay}: its firmware-name {name!r} is another bitstream than {image.path}")
