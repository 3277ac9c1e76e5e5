# SPDX-License-Identifier: Apache-2.0
"""What the manager is given: devices, files, a data plane, the time and an observer. Protocols only: they are
for checkers of types, and a manager that runs does not import them.

`cm.device` has all that is asked for here, and `cm.server` puts it together; nothing of either is imported, so
the manager runs, and is tested, where no shim was compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Protocol

from cm.manager.inputs import Image, Window
from cm.schema.model import Config, Module, Overlay
from cm.wire.messages.status import RegionColumn, RegValues


class RegisterTable(Protocol):
    """Registers that clients on this machine read by themselves, as long as each name leads where it did."""

    def offer(self, name: str, uio: Any, place: tuple[int, int, int], bits: tuple[int, int]) -> None:
        """Put one in: a device of `Devices.window`; map, offset and width; lowest bit and mask. Raises DeviceError."""

    def withdraw(self) -> None:
        """Take all out: no read is under way when it returns."""


class GrantedPages(Protocol):
    """Pages on loan: a number by which they are taken back, and a descriptor to be given away."""

    @property
    def id(self) -> int:
        """The number."""

    @property
    def fd(self) -> int:
        """The descriptor, its owner's."""


class GrantEnded(Protocol):
    """A grant that ended."""

    @property
    def id(self) -> int:
        """Its number."""

    @property
    def reason(self) -> int:
        """0: nobody has it any more; else why it was taken back."""


class WindowLender(Protocol):
    """What lends pages of registers, and takes them back. All raise DeviceError."""

    def grant(self, address: int, length: int, write: bool = False) -> GrantedPages:
        """Lend whole pages at a physical address."""

    def revoke(self, address: int, length: int) -> int:
        """Take back whatever of a range was lent; returns from how many."""

    def revoke_grant(self, number: int) -> bool:
        """Take one back. Raises FileNotFoundError where nobody has it any more."""

    def take(self) -> Sequence[GrantEnded]:
        """Those that have ended by themselves since the last call."""

    def fileno(self) -> int:
        """Polls readable when there are such."""

    def close(self) -> None:
        """Take back all."""


class OverlayFolder(Protocol):
    """Device-tree overlays, by name. All but `available` raise DeviceError."""

    def available(self) -> bool:
        """Whether this kernel can apply any."""

    def list(self) -> Collection[str]:
        """Those that are applied."""

    def has(self, name: str) -> bool:
        """Whether there is one of this name."""

    def apply(self, name: str, dtbo: bytes) -> None:
        """Put one on."""

    def remove(self, name: str) -> None:
        """Take one off."""


class PlClock(Protocol):
    """A clock of the processing system for the PL. All raise DeviceError."""

    rate: int  # Hz; what was set is rounded without an error, so it is read back
    enabled: bool  # whether it is held running

    def rounded(self, hertz: int) -> int | None:
        """What it would run at if it were set to `hertz`; None where that cannot be asked."""


class OutputLine(Protocol):
    """A line that the processor drives. Raises DeviceError."""

    value: int  # 0 or 1; setting it makes the line an output


class Clocks(Protocol):
    """The clocks of a board. All raise DeviceError."""

    def names(self) -> Collection[str]:
        """Those that can be set; none where the kernel has no driver for them."""

    def find(self, name: str) -> PlClock:
        """One of them, by any of its names. Raises NotFound with those that there are."""


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


class WrongFrame(Protocol):
    """A frame that does not hold what was loaded."""

    @property
    def far(self) -> int:
        """Its address as a word."""

    @property
    def address(self) -> FramePlace:
        """Its address."""

    @property
    def bits(self) -> tuple[int, ...]:
        """Those that differ: 32 times the word, and the bit in it."""


class FramePlace(Protocol):
    """Where a frame lies."""

    @property
    def block_type(self) -> int:
        """0: logic and routing, 1: contents of block RAM."""

    @property
    def row(self) -> int:
        """Of the device."""

    @property
    def column(self) -> int:
        """In the row."""

    @property
    def minor(self) -> int:
        """In the column."""


class FrameSlice(Protocol):
    """Frames that are read in one go; words as they lie in memory for DMA."""

    @property
    def request(self) -> bytes:
        """What is written to the port first."""

    @property
    def reply_length(self) -> int:
        """Bytes that are read then."""

    @property
    def closing(self) -> bytes:
        """What is written at the end."""

    @property
    def judge(self) -> Callable[[memoryview], Sequence[WrongFrame]]:
        """Which of them are wrong, from what was read."""


class LoadedFrames(Protocol):
    """The frames of a bitstream, to compare with what a port gives."""

    @property
    def judged(self) -> int:
        """How many are compared."""

    @property
    def unjudged(self) -> Sequence[FramePlace]:
        """Those that cannot be."""

    @property
    def why(self) -> str:
        """Why not, and how it is known what the fabric itself changes; a sentence."""

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""

    def slices(self, most: int) -> Sequence[FrameSlice]:
        """All that are compared, `most` at a time."""

    def repair(self, wrong: Sequence[Any]) -> bytes | None:
        """Words that write frames anew; None where that would destroy what the fabric holds in them."""


class PortBuffer(Protocol):
    """Memory from which a configuration port can load."""

    @property
    def length(self) -> int:
        """Bytes."""

    def memoryview(self) -> memoryview:
        """Its bytes, to be written between `sync_begin` and `sync_end`."""

    def unmap(self) -> None:
        """Its bytes are not needed for now; `memoryview` has them again."""

    def sync_begin(self, write: bool) -> None:
        """The processor accesses it from here on."""

    def sync_end(self, write: bool) -> None:
        """The processor has accessed it."""

    def close(self) -> None:
        """Give it back. Raises Busy while a load uses it."""


class PortInfo(Protocol):
    """A configuration port."""

    @property
    def idcode(self) -> int:
        """Of its device; 0 where the driver does not know it."""

    @property
    def denied(self) -> bool:
        """Whether the platform's firmware does not let the port be used."""

    @property
    def readable(self) -> bool:
        """Whether words can be read from it."""

    @property
    def max_length(self) -> int:
        """Bytes of a load, or of one part of a read, at most."""

    @property
    def clock_hz(self) -> int:
        """Its clock; 0 where the driver does not know it."""


class PortStatus(Protocol):
    """What a configuration port does."""

    @property
    def loading(self) -> bool:
        """Whether a load runs, also one that another process began."""

    @property
    def bytes_done(self) -> int:
        """Of the running or the last load."""


class PortCompletion(Protocol):
    """The end of a load."""

    @property
    def cookie(self) -> int:
        """What the load was begun with."""

    @property
    def status(self) -> int:
        """0, or a negative errno."""

    @property
    def length(self) -> int:
        """Bytes that the port took, or gave."""

    @property
    def reason(self) -> str:
        """A sentence for why it failed."""


class ConfigPort(Protocol):
    """A configuration access port that loads from memory by itself. All raise DeviceError."""

    @property
    def info(self) -> PortInfo:
        """What it is."""

    def allocate(self, length: int) -> PortBuffer:
        """At least `length` bytes."""

    def load(
        self, buffer: Any, length: int | None = None, *, cookie: int = 0, full: bool = False, encrypted: bool = False
    ) -> None:
        """Start a load of a buffer of its own, and return at once."""

    def read(self, buffer: Any, request: slice, reply: slice, closing: slice, cookie: int = 0) -> None:
        """Start a read, whose parts are bytes of a buffer of its own, and return at once."""

    def wait(self, timeout: float | None = None) -> PortCompletion:
        """The next end of a load. Raises TimeoutError after `timeout` seconds."""

    def status(self) -> PortStatus:
        """What it does now."""


class KernelLoader(Protocol):
    """The kernel's FPGA manager."""

    @property
    def name(self) -> str:
        """As the kernel calls it."""

    @property
    def state(self) -> str:
        """``operating`` after a load that went well."""

    @property
    def can_load(self) -> bool:
        """Whether it can be told to load through sysfs."""

    def load(self, firmware_name: str, partial: bool = False, encrypted: bool = False) -> None:
        """Load a file below /lib/firmware; returns when the kernel is done. Raises DeviceError."""


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

    def forget(self, config: str) -> None:
        """This configuration was replaced: what was learned from its files is no longer so."""


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
