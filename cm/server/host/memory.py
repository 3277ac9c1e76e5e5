# SPDX-License-Identifier: Apache-2.0
"""Contiguous memory that masters in the PL can reach, from whichever device of the board provides it."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cm.device import AxiDma, DeviceBusy, DeviceError, DeviceNotFound, DmaBuffer, Icap, Root, list_dma
from cm.errors import NotFound


@dataclass(frozen=True, slots=True)
class DeviceMemory:
    """`length` bytes behind a descriptor, which the device has at `address`; `free` gives them back."""

    fd: int
    length: int
    coherent: bool
    address: int
    free: Callable[[], None]


def device_memory(length: int, root: Root) -> DeviceMemory:
    """Whole pages, `length` bytes at least.

    Raises DeviceError, NotFound if no device provides any. A configuration port may be open several times, so an open
    one of our own holds the memory. A DMA channel may not: it is closed at once, and the descriptor alone keeps the
    memory.
    """
    try:
        return port_memory(length, root)
    except DeviceNotFound:
        return _of_channel(length, root)


def port_memory(length: int, root: Root) -> DeviceMemory:
    """Likewise, of a configuration port only. Raises DeviceError; DeviceNotFound where there is none. Any thread."""
    port = Icap.open(root=root)
    try:
        buffer = _told(port.allocate(length))
    except BaseException:
        port.close()
        raise

    def free() -> None:
        with suppress(DeviceError):
            buffer.close()
        port.close()

    return DeviceMemory(buffer.fd, buffer.length, buffer.coherent, buffer.address, free)


def _of_channel(length: int, root: Root) -> DeviceMemory:
    busy: DeviceError | None = None
    for name in list_dma(root):
        try:
            with AxiDma.open(name, root) as channel:
                return _kept(_told(channel.allocate(length)))
        except DeviceBusy as error:
            busy = error
    if busy is not None:
        raise busy
    raise NotFound("no device of this board gives memory: it has neither a configuration port nor a DMA channel")


def _kept(buffer: DmaBuffer) -> DeviceMemory:
    fd = os.dup(buffer.fd)
    return DeviceMemory(fd, buffer.length, buffer.coherent, buffer.address, lambda: os.close(fd))


def _told(buffer: DmaBuffer) -> DmaBuffer:
    if buffer.address:
        return buffer
    buffer.close()
    raise NotFound("the kernel module does not report the addresses of memory: it is older than this package")
