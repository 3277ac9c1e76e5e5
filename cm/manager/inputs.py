# SPDX-License-Identifier: Apache-2.0
"""Data that devices and files (`cm.manager.interfaces`) hand the manager: places of registers, and images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from cm.frozen import dataclass


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

    @property
    def present(self) -> bool:
        """Whether it is still there, and not another one in its place."""

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


@dataclass(frozen=True, slots=True)
class Image:
    """A validated bitstream: where it lies, its hash, and what is asked of it before a load."""

    path: Path
    sha256: str
    length: int  # bytes of the stream, as the port takes it
    idcode: int | None  # of the device that it was made for, where it says so
    partial: bool
    encrypted: bool
