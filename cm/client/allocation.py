# SPDX-License-Identifier: Apache-2.0
"""Arrays in memory that masters in the PL reach by address: HLS kernels with `m_axi`."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterable, Sequence
from operator import index
from pathlib import Path
from typing import Any

import numpy as np

from cm.client.data_connection import DataConnection
from cm.client.errors import BoardClosed
from cm.client.mapping import SlotMappings
from cm.errors import InvalidRequest, Timeout
from cm.wire.plane_packets import Open, Purpose


class DeviceArray(np.ndarray[Any, np.dtype[Any]]):
    """An array, or a slice of one, that a master in the PL finds at `device_address`.

    The memory is freed with the last array in it, by `free`, or with this process.
    """

    _memory: _Memory | None = None

    def __array_finalize__(self, origin: Any) -> None:
        self._memory = getattr(origin, "_memory", None)

    @property
    def device_address(self) -> int:
        """The address of its first byte for the device. Raises InvalidRequest for an array in ordinary memory."""
        memory, place = self._memory, self.__array_interface__["data"][0]
        if memory is None or not memory.begin <= place < memory.begin + memory.length:
            raise InvalidRequest("this array lies in ordinary memory: a result of arithmetic, or a copy, is not part")
        return memory.address + int(place - memory.begin)

    def sync_to_device(self) -> None:
        """Make what was written visible to the device; does nothing if the memory is coherent."""
        if self._memory is not None:
            self._memory.to_device()

    def sync_from_device(self) -> None:
        """Make what the device has written visible here; does nothing if the memory is coherent."""
        if self._memory is not None:
            self._memory.from_device()

    def hand_over(self, to_device: bool) -> None:
        """Write the processor's caches back, or let go of what they hold, also a second time."""
        if self._memory is not None:
            self._memory.hand_over(to_device)

    @property
    def hold(self) -> object:
        """Whoever has this keeps the memory from being freed; None if it is free, or ordinary memory."""
        return self._memory and next(iter(self._memory.holds), None)

    def free(self) -> None:
        """Free the memory behind transfers under way, even if arrays in it are left: the device must not use it."""
        if self._memory is not None:
            self._memory.free()


class _Hold:
    """Memory is freed with the last reference to this: of its owner, and of each transfer."""


class _Memory:
    """A connection to the data socket that holds memory, and the memory's address."""

    def __init__(self, connection: DataConnection, mappings: SlotMappings, length: int) -> None:
        self.holds = [_Hold()]  # the owner's, until it frees the memory
        weakref.finalize(self.holds[0], connection.close).atexit = False  # type: ignore[misc]
        self._mappings = mappings
        self.length = length
        self.address = connection.address
        self.begin = 0

    def to_device(self) -> None:
        self._mappings.end(0)

    def hand_over(self, to_device: bool) -> None:
        self._mappings.hand_over(0, to_device)

    def from_device(self) -> None:
        self._mappings.begin(0)

    def free(self) -> None:
        self.to_device()
        self.holds.clear()


def nbytes(shape: int | Sequence[int], dtype: Any) -> int:
    """Bytes of an array. Raises InvalidRequest for an impossible shape or dtype."""
    try:
        extents = tuple(map(index, shape)) if isinstance(shape, Iterable) else (index(shape),)
        kind = np.dtype(dtype)
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"an array of shape {shape!r} and type {dtype!r}: {error}") from error
    if kind.hasobject:
        raise InvalidRequest(
            f"an array of type {kind}: it would hold addresses of Python's objects, which devices do not know"
        )
    length: int = math.prod(extents) * int(kind.itemsize)
    if length <= 0 or min(extents, default=1) <= 0:
        raise InvalidRequest(f"an array of shape {shape!r} has no bytes")
    return length


class _Request:
    """A request for memory. Memory that has come outlives the board."""

    def __init__(self, folder: Path, length: int) -> None:
        self._connection = DataConnection(folder, Open("", Purpose.ALLOCATE, length=length))
        self._ended: BoardClosed | None = None
        self._answered = False

    def end(self, because: BoardClosed) -> None:
        """The board is closed: a thread that still waits raises BoardClosed."""
        self._ended = because
        if not self._answered:
            self._connection.close()

    def answer(self, timeout: float | None) -> tuple[DataConnection, SlotMappings]:
        """The memory, and the connection that holds it. Raises the manager's refusal, Timeout, BoardClosed."""
        connection, memory = self._connection, None
        try:
            connection.set_timeout(timeout)
            while connection.memory is None or not connection.address:
                connection.receive()
            self._answered = True
            self._check()  # an end() from here on leaves the memory to its owner
            memory = connection.memory
        except BlockingIOError:
            raise Timeout(f"memory: the manager did not answer within {timeout or 0:g} s") from None
        except Exception:
            self._check()  # closed by another thread
            raise
        finally:
            if memory is None:
                connection.close()
        return connection, memory

    def _check(self) -> None:
        if self._ended is not None:
            raise self._ended from None


def allocated(
    folder: Path,
    shape: int | Sequence[int],
    dtype: Any,
    timeout: float | None,
    using: Callable[[_Request], _Request],
) -> DeviceArray:
    """Allocate from the manager that serves `folder`; `using` makes the request known to the board.

    Raises InvalidRequest, RequestFailed, Timeout, ConnectionLost, BoardClosed.
    """
    length = nbytes(shape, dtype)
    connection, memory = using(_Request(folder, length)).answer(timeout)
    return _array(connection, memory, shape, dtype, length)


def _array(
    connection: DataConnection, mappings: SlotMappings, shape: int | Sequence[int], dtype: Any, length: int
) -> DeviceArray:
    mapping = mappings.take(0)
    memory = _Memory(connection, mappings, length)
    weakref.finalize(mapping, memory.holds.clear).atexit = False  # type: ignore[misc] # arrays in it refer to it
    array = DeviceArray(shape, dtype, mapping)
    memory.begin = array.__array_interface__["data"][0]
    array._memory = memory
    memory.from_device()
    return array
