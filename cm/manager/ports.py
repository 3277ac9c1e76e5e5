# SPDX-License-Identifier: Apache-2.0
"""What the manager is given: devices, files, a data plane, a clock and somebody who listens."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cm.bitstream import Report
from cm.device import FpgaManager, Icap, Overlays, Uio
from cm.messages.status import Irq, RegValues
from cm.schema.model import Config, Module, Overlay


@dataclass(frozen=True, slots=True)
class Window:
    """A register's place: a UIO device, the number of its map and the offset in it (bytes)."""

    uio: Uio
    map: int
    offset: int


class Devices(Protocol):
    """Open devices of one board. Handles belong to the provider, which keeps and closes them."""

    def boot_id(self) -> str:
        """An id that is new whenever the board was started anew."""

    def window(self, address: int, width: int) -> Window:
        """Where `width` bits at a physical address are mapped. Raises DeviceNotFound."""

    def icap(self, name: str | None) -> Icap:
        """A configuration access port; the only one if no name is given."""

    def fpga_manager(self, name: str | None) -> FpgaManager:
        """The kernel's FPGA manager."""

    def overlays(self) -> Overlays:
        """The device-tree overlays."""

    def forget(self) -> None:
        """Close register windows: UIO devices may have come or gone with an overlay."""

    def lost(self) -> None:
        """Close everything: the board is gone, or is another one now."""


@dataclass(frozen=True, slots=True)
class Image:
    """A validated bitstream: where it lies, its hash, and what was found in it."""

    path: Path
    sha256: str
    length: int  # bytes of the stream, as the port takes it
    report: Report


class Files(Protocol):
    """Bitstreams and overlays of a configuration."""

    def image(self, config: Config, module: Module) -> Image:
        """The validated image of a module. Raises the refusals of `cm.bitstream`, NotFound."""

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


class DataPlane(Protocol):
    """The streams, as far as a change has to stop and start them."""

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop these streams; when it returns no transfer of theirs is under way."""

    def resume(self, config: Config | None, mode: str | None) -> None:
        """Streams are those of this mode now; start again what somebody listens to."""


class Clock(Protocol):
    """Time, so that tests can hold it."""

    def monotonic(self) -> float:
        """Seconds."""


class Observer(Protocol):
    """Who is told; called from any thread, must not block."""

    def status_changed(self) -> None:
        """The status differs from before."""

    def registers_changed(self, values: RegValues) -> None:
        """Registers were written."""

    def interrupt(self, irq: Irq) -> None:
        """An interrupt came."""
