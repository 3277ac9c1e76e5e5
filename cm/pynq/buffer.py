# SPDX-License-Identifier: Apache-2.0
"""`allocate`: arrays in contiguous memory that masters in the PL reach, with PYNQ's names."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy.typing as npt

from cm.client.allocation import DeviceArray
from cm.pynq.board import board


class PynqBuffer(DeviceArray):
    """An array of `allocate`, or a slice of one.

    `flush` and `invalidate` take the whole memory. Results of arithmetic and copies have no address: asking for one
    raises InvalidRequest.
    """

    @property
    def physical_address(self) -> int:
        """The address of its first byte for the device."""
        return self.device_address

    @property
    def virtual_address(self) -> int:
        """The address of its first byte in this process."""
        return int(self.__array_interface__["data"][0])

    def flush(self) -> None:
        """Make what was written visible to the device."""
        self.sync_to_device()

    def invalidate(self) -> None:
        """Make what the device has written visible here."""
        self.sync_from_device()

    def freebuffer(self) -> None:
        """Free the memory now; the device must not use it any more. Twice is fine."""
        self.free()

    def close(self) -> None:
        """Nothing, as PYNQ's."""
        warnings.warn(".close no longer functional - use scopes to manage buffers", DeprecationWarning, stacklevel=2)

    def __enter__(self) -> PynqBuffer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.free()


def allocate(
    shape: int | Sequence[int],
    dtype: npt.DTypeLike = "u4",
    target: Any = None,  # noqa: ARG001 (PYNQ's; a program has one board)
    **_: Any,
) -> PynqBuffer:
    """An array in contiguous memory, zero at first. Raises InvalidRequest, RequestBusy if there is no more."""
    return board().allocate(shape, dtype).view(PynqBuffer)


class Xlnk:
    """What old notebooks allocate with."""

    def cma_array(self, shape: int | Sequence[int], dtype: npt.DTypeLike = "u4", **_: Any) -> PynqBuffer:
        """As `allocate`."""
        return allocate(shape, dtype)

    def xlnk_reset(self) -> None:
        """Nothing: memory is freed with its arrays, and that of other programs is theirs."""
