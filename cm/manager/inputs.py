# SPDX-License-Identifier: Apache-2.0
"""Data that devices and files (`cm.manager.interfaces`) hand the manager: places of registers, and images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cm.frozen import dataclass

if TYPE_CHECKING:
    from cm.device import Uio


@dataclass(frozen=True, slots=True)
class Window:
    """A register's place: a device, the number of its map and the offset in it (bytes)."""

    device: Uio
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
