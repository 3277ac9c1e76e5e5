# SPDX-License-Identifier: Apache-2.0
"""`allocate`: arrays in contiguous memory that masters in the PL reach, with PYNQ's names."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partialmethod
from typing import Any

import numpy.typing as npt

from cm.client.allocation import DeviceArray
from cm.pynq.board import board


class PynqBuffer(DeviceArray):
    """An array of `allocate`, or a slice of one.

    `flush` and `invalidate` take the whole memory, each time. Results of arithmetic and copies have no address: asking
    for one raises InvalidRequest.
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
    return board().allocate(shape, dtype).view(PynqBuffer)


class Xlnk:
    """What old notebooks allocate with."""

    cma_array = staticmethod(allocate)

    def xlnk_reset(self) -> None:
        """Nothing: memory is freed with its arrays, and that of other programs is theirs."""
