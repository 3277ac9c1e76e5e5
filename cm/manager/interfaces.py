# SPDX-License-Identifier: Apache-2.0
"""What the manager is given: devices, files, a data plane, the time and an observer. For checkers of types: a manager
that runs does not import this.

So it runs, and is tested, where no shim was compiled. `cm.server` puts it together with these classes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

from cm.manager.inputs import Image, Window
from cm.schema.model import Config, Module, Overlay
from cm.wire.messages.status import RegionColumn, RegValues

if TYPE_CHECKING:
    from cm.device import DmaBuffer as PortBuffer
    from cm.device import FpgaManager as KernelLoader
    from cm.device import GpioLine as OutputLine
    from cm.device import Icap as ConfigPort
    from cm.device import Overlays as OverlayFolder
    from cm.device import PlClocks as Clocks
    from cm.device.clocks import PlClock
    from cm.device.icap import IcapCompletion as PortCompletion
    from cm.device.icap import IcapInfo as PortInfo
    from cm.device.register_reads import RegisterReads as RegisterTable
    from cm.device.register_window import Windows as WindowLender
    from cm.device.uio import UioMap as AddressRange
    from cm.formats.bitstream.readback import LoadedFrames, WrongFrame
    from cm.formats.bitstream.readback import Slice as FrameSlice

__all__ = [
    "AddressRange",
    "Clocks",
    "ConfigPort",
    "DataPlane",
    "Devices",
    "Files",
    "FrameSlice",
    "KernelLoader",
    "LoadedFrames",
    "Observer",
    "OutputLine",
    "OverlayFolder",
    "PlClock",
    "PortBuffer",
    "PortCompletion",
    "PortInfo",
    "RegisterTable",
    "TimeSource",
    "WindowLender",
    "WrongFrame",
]


class Devices(Protocol):
    """Open devices of one board. Handles belong to the provider, which keeps and closes them."""

    def boot_id(self) -> str:
        """An id that is new whenever the board was started anew."""

    def holds_design(self) -> bool:
        """Whether the logic is known to hold a design; found out without touching it."""

    def window(self, address: int, width: int) -> Window:
        """Where `width` bits at a physical address are mapped. Raises DeviceNotFound."""

    def windows(self) -> WindowLender:
        """What lends register pages, opened anew: the caller's. Raises NoWindow where there is none."""

    def icap(self, name: str | None) -> ConfigPort:
        """A configuration access port; the only one if no name is given."""

    def fpga_manager(self, name: str | None) -> KernelLoader:
        """The kernel's FPGA manager."""

    def overlays(self) -> OverlayFolder:
        """The device-tree overlays."""

    def gpio(self, chip: str, line: int | str) -> OutputLine:
        """A line of a GPIO chip, by the chip's label or name and its own place or name; held until `lost`.

        Raises DeviceError.
        """

    def clocks(self) -> Clocks:
        """The clocks of the processing system for the PL."""

    def check(self) -> None:
        """Ask the board for something that changes nothing. Raises DeviceError where it does not answer."""

    def forget(self) -> bool:
        """Close register devices and ports that have gone, as with an overlay; whether any has."""

    def lost(self) -> None:
        """Close everything: the board is gone, or is another one now."""


class Files(Protocol):
    """Bitstreams and overlays of a configuration."""

    def image(self, config: Config, module: Module) -> Image:
        """The validated image of a module. Raises the refusals of `cm.formats.bitstream`, NotFound."""

    def static_image(self, config: Config) -> Image:
        """The validated image of a full configuration."""

    def port_bytes(self, image: Image) -> bytes:
        """The image as words in the order in which a DMA-fed port takes them from memory."""

    def loaded_frames(self, image: Image) -> LoadedFrames:
        """What the image leaves in the device, and how much of it can be compared with what is read back.

        Raises Sha256Mismatch where the file is another one now.
        """

    def columns(self, image: Image) -> tuple[str, list[RegionColumn]]:
        """The image's device, and the bits that it sets in each column of frames.

        Raises Sha256Mismatch, and UnknownDevice where the device's columns are not known.
        """

    def firmware_name(self, image: Image) -> str:
        """A name below /lib/firmware under which the kernel finds our own copy of the image in .bin form."""

    def check_firmware(self, name: str, image: Image) -> None:
        """Raise Sha256Mismatch where the kernel finds something else under the name than the image."""

    def overlay(self, config: Config, overlay: Overlay, images: Sequence[Image]) -> bytes:
        """The .dtbo, without what would load one of `images`, which the device holds when it is applied.

        Raises BadOverlay where it would load anything else.
        """

    def clashes(self, overlays: Mapping[str, bytes], going: Collection[str]) -> Mapping[str, str]:
        """What prevents drivers of overlays, by name: a sentence with what another device of the live tree has.

        `going`: overlays that are applied, and whose devices go before.
        """

    def loading_overlay(self, config: Config, module: Module, image: Image) -> bytes:
        """The .dtbo by which a module is loaded, ``<module>.dtbo``, with the `firmware_name` of its image.

        Raises BadOverlay where the firmware it names has not the content of `image`.
        """


class DataPlane(Protocol):
    """The streams, as far as a change has to stop and start them."""

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop these streams; when it returns no transfer of theirs is under way."""

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        """Streams are those of this mode now, where regions hold what `held` says; start again what is listened to."""

    def wrote(self, generation: int) -> None:
        """Registers were written, by requests or a change: frames that begin from now on have this generation."""


class TimeSource(Protocol):
    """The time that passes; Python's module `time` is one, and tests have their own."""

    def monotonic(self) -> float:
        """Seconds."""


class Observer(Protocol):
    """It is told of what changes; called from any thread, must not block."""

    def status_changed(self) -> None:
        """The status differs from before."""

    def progressed(self) -> None:
        """Likewise, in nothing but how far the running change is."""

    def registers_changed(self, values: RegValues) -> None:
        """Registers were written."""
