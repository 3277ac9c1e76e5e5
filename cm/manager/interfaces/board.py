# SPDX-License-Identifier: Apache-2.0
"""The devices of one board, open."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

from cm.manager.interfaces.loading import ConfigPort, KernelLoader
from cm.manager.interfaces.registers import Window


class OverlayFolder(Protocol):
    """Device-tree overlays, by name. All but `available` raise DeviceError."""

    def available(self) -> bool:
        """Whether this kernel can apply any."""

    def list(self) -> Collection[str]:
        """Those that are applied."""

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

    def window(self, address: int, width: int) -> Window:
        """Where `width` bits at a physical address are mapped. Raises DeviceNotFound."""

    def icap(self, name: str | None) -> ConfigPort:
        """A configuration access port; the only one if no name is given."""

    def fpga_manager(self, name: str | None) -> KernelLoader:
        """The kernel's FPGA manager."""

    def overlays(self) -> OverlayFolder:
        """The device-tree overlays."""

    def gpio(self, chip: str, line: int) -> OutputLine:
        """A line of a GPIO chip, by the chip's label or name; held until `lost`. Raises DeviceError."""

    def clocks(self) -> Clocks:
        """The clocks of the processing system for the PL."""

    def check(self) -> None:
        """Ask the board for something that changes nothing. Raises DeviceError where it does not answer."""

    def forget(self) -> None:
        """Close register windows: UIO devices may have come or gone with an overlay."""

    def lost(self) -> None:
        """Close everything: the board is gone, or is another one now."""
