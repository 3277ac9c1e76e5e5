# SPDX-License-Identifier: Apache-2.0
"""Devices whose registers the manager reads and writes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


class AddressRange(Protocol):
    """A run of physical addresses."""

    @property
    def address(self) -> int:
        """The first one."""

    @property
    def size(self) -> int:
        """Bytes."""


class RegisterDevice(Protocol):
    """Maps of registers, read and written by accesses of 8 to 64 bits. All raise DeviceError."""

    @property
    def maps(self) -> Sequence[AddressRange]:
        """What is mapped, in order."""

    def read(self, offset: int, width: int = 32, map: int = 0) -> int:  # noqa: A002 (as in `cm.device.Uio`)
        """The value at an offset (bytes) of a map; `width` in bits."""

    def write(self, offset: int, value: int, width: int = 32, map: int = 0) -> None:  # noqa: A002
        """Write to an offset of a map."""

    def read_block(self, offset: int, length: int, map: int = 0) -> bytearray:  # noqa: A002
        """`length` bytes by accesses of 32 bits."""

    def write_block(self, offset: int, data: memoryview, map: int = 0) -> None:  # noqa: A002
        """Write bytes by accesses of 32 bits."""


@dataclass(frozen=True, slots=True)
class Window:
    """A register's place: a device, the number of its map and the offset in it (bytes)."""

    device: RegisterDevice
    map: int
    offset: int
