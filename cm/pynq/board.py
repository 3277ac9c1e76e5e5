# SPDX-License-Identifier: Apache-2.0
"""The one board of a program, as PYNQ's calls name none: its buffers, interrupts and clocks."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from functools import cache, partialmethod
from typing import Any
from weakref import WeakValueDictionary

import numpy.typing as npt

from cm.client.allocation import DeviceArray
from cm.client.board import Board, connect
from cm.client.places import Places
from cm.errors import NotFound, Timeout

_SLICE = 0.25  # seconds that a thread waits before it looks whether anybody still wants it to


@cache
def board() -> Board:
    """The board, connected at the first use: that of `$CM_CONNECT`, or of this machine."""
    return connect()


@cache
def places() -> Places:
    """The words of the board."""
    return Places(board())


class PynqBuffer(DeviceArray):
    """An array of `allocate`, or a slice of one.

    `flush` and `invalidate` take the whole memory. A copy, or a result of arithmetic, has no address: InvalidRequest.
    """

    physical_address = DeviceArray.device_address
    freebuffer = DeviceArray.free
    sync_to_device = flush = partialmethod(DeviceArray.hand_over, to_device=True)
    sync_from_device = invalidate = partialmethod(DeviceArray.hand_over, to_device=False)

    def close(self) -> None:
        """Nothing, as PYNQ's."""

    def __enter__(self) -> PynqBuffer:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


def allocate(shape: int | Sequence[int], dtype: npt.DTypeLike = "u4", *_: Any, **__: Any) -> PynqBuffer:
    """An array in contiguous memory, zero at first. Raises InvalidRequest, RequestBusy if there is no more."""
    buffer = board().allocate(shape, dtype).view(PynqBuffer)
    _allocated[buffer.physical_address] = buffer
    return buffer


_allocated: WeakValueDictionary[int, PynqBuffer] = WeakValueDictionary()


def buffer_at(address: int) -> tuple[PynqBuffer, int]:
    """The buffer of `allocate` that has a byte, and which byte of it that is. Raises NotFound."""
    for first, buffer in reversed(list(_allocated.items())):  # an older one there has been freed
        if first <= address < first + buffer.nbytes:
            return buffer, address - first
    raise NotFound(f"no buffer that this program allocated is at {address:#x}")


class Xlnk:
    """What old notebooks allocate with."""

    cma_array = staticmethod(allocate)

    def xlnk_reset(self) -> None:
        """Nothing: memory is freed with its arrays, and that of other programs is theirs."""


class Interrupt:
    """The interrupt of a pin, such as ``"filter/interrupt"``; whether there is one is checked when it is awaited."""

    def __init__(self, pinname: str) -> None:
        self._name = pinname.replace("/", "_").lower()

    async def wait(self) -> None:
        """Until it comes; one that came since this program's last wait counts. Raises RequestNotFound."""
        while True:
            with suppress(Timeout):
                await asyncio.to_thread(board().interrupts[self._name].wait, _SLICE)
                return


class _Clocks:
    """``Clocks.fclk0_mhz`` and so on, in MHz. Setting one raises NotImplementedError."""

    def __getattr__(self, name: str) -> float:
        for clock in board().status.clocks if name.endswith("_mhz") else ():
            if name in (f"{clock.name}_mhz", f"{clock.name}_mhz".replace("pl", "fclk")):  # as PYNQ's on any device
                return (clock.rate or clock.wanted) / 1e6
        raise AttributeError(f"the loaded configuration has no {name!r}, of fclk0_mhz to fclk3_mhz")

    def __setattr__(self, name: str, value: Any) -> None:
        raise NotImplementedError(
            f"Clocks.{name} = {value}: a rate belongs to the configuration (`clocks:` of its schema), which sets it "
            "with each load"
        )


Clocks = _Clocks()
