# SPDX-License-Identifier: Apache-2.0
"""What loads configuration data: ports that read memory by themselves, and the kernel's FPGA manager."""

from __future__ import annotations

from typing import Any, Protocol


class PortBuffer(Protocol):
    """Memory from which a configuration port can load."""

    @property
    def length(self) -> int:
        """Bytes."""

    def memoryview(self) -> memoryview:
        """Its bytes, to be written between `sync_begin` and `sync_end`."""

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
