# SPDX-License-Identifier: Apache-2.0
"""The files of a configuration, for the manager: found, validated, and given to the kernel in the form it takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cm.errors import CmError
from cm.formats.bitstream import (
    expect_module,
    expect_static,
    footprint_of,
    to_dma_words,
)
from cm.manager.interfaces import Image, LoadedFrames
from cm.schema.files import bitstream_path
from cm.schema.model import Config, Module, Overlay, Region
from cm.server.bitstream_files import BitstreamReader, FirmwareFolder, image_of
from cm.server.footprints import Footprints, Frames, LearnedFootprint
from cm.server.overlays import OverlayFiles
from cm.wire.messages.status import RegionColumn

_FRAMES_KEPT = 4  # images whose frames are ready to be compared


class BoardFiles:
    """`cm.manager.interfaces.Files` over the file system below a root."""

    def __init__(self, root: Path, footprints: Footprints | None = None, copies: Path | None = None) -> None:
        """`copies`: the folder for files converted for the kernel, see `FirmwareFolder`."""
        self._root = root
        self._reader = BitstreamReader()
        self._firmware = FirmwareFolder(root, self._reader, copies)
        self._footprints = footprints or Footprints()
        self._frames: dict[str, LoadedFrames] = {}  # by the image's hash
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

    def columns(self, image: Image) -> tuple[str, list[RegionColumn]]:
        """For whoever wants to see them: no start waits for these modules."""
        from cm.formats.bitstream.memory import frames_in
        from cm.formats.xray.fabric import fabric

        device, frames = frames_in(self._reader.read(image))
        return device.name, [RegionColumn(c.address, c.bits, c.switches, c.logic, c.clock) for c in fabric(frames)]

    def loaded_frames(self, image: Image) -> LoadedFrames:
        """What an image leaves in the device. Those of the last few are kept: scrubbing asks again and again."""
        from cm.formats.bitstream.container import open_image
        from cm.formats.bitstream.devices import device_by_idcode
        from cm.formats.bitstream.errors import UnknownDevice
        from cm.formats.bitstream.mask import mask_for
        from cm.formats.bitstream.readback import LoadedFrames as Loaded

        found = self._frames.pop(image.sha256, None)
        if found is None:
            device = device_by_idcode(image.idcode) if image.idcode is not None else None
            if device is None or image.encrypted:
                what = "is encrypted" if image.encrypted else "is for a device that is not known"
                raise UnknownDevice(f"{image.path} {what}: its frames cannot be compared")
            found = Loaded(device, open_image(self._reader.read(image)), mask_for(image.path, device))
        self._frames[image.sha256] = found
        while len(self._frames) > _FRAMES_KEPT:
            self._frames.pop(next(iter(self._frames)))
        return found

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
