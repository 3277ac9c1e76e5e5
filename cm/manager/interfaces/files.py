# SPDX-License-Identifier: Apache-2.0
"""Bitstreams and overlays of configurations, validated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cm.schema.model import Config, Module, Overlay


@dataclass(frozen=True, slots=True)
class Image:
    """A validated bitstream: where it lies, its hash, and what is asked of it before a load."""

    path: Path
    sha256: str
    length: int  # bytes of the stream, as the port takes it
    idcode: int | None  # of the device that it was made for, where it says so
    partial: bool
    encrypted: bool


class Files(Protocol):
    """Bitstreams and overlays of a configuration."""

    def image(self, config: Config, module: Module) -> Image:
        """The validated image of a module. Raises the refusals of `cm.formats.bitstream`, NotFound."""

    def static_image(self, config: Config) -> Image:
        """The validated image of a full configuration."""

    def port_bytes(self, image: Image) -> bytes:
        """The image as words in the order in which a DMA-fed port takes them from memory."""

    def firmware_name(self, image: Image) -> str:
        """A name below /lib/firmware under which the kernel finds our own copy of the image in .bin form."""

    def check_firmware(self, name: str, image: Image) -> None:
        """Raise Sha256Mismatch where the kernel finds something else under the name than the image."""

    def overlay(self, config: Config, overlay: Overlay, images: Sequence[Image]) -> bytes:
        """The .dtbo, without what would load one of `images`, which the device holds when it is applied.

        Raises BadOverlay where it would load anything else.
        """

    def loading_overlay(self, config: Config, module: Module, image: Image) -> bytes:
        """The .dtbo by which a module is loaded, ``<module>.dtbo``, with the `firmware_name` of its image.

        Raises BadOverlay where the firmware it names has not the content of `image`.
        """

    def forget(self, config: str) -> None:
        """This configuration was replaced: what was learned from its files is no longer so."""
