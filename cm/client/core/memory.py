# SPDX-License-Identifier: Apache-2.0
"""Memories as numpy arrays: the requests of a read or write, for both clients.

The functions here are generators: they yield calls, are sent the results, and return the value.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import TYPE_CHECKING, Any

from cm.client.core import calls
from cm.client.core.calls import Call
from cm.errors import InvalidRequest
from cm.wire.messages.status import ConfigInfo, FrameInfo, MemoryInfo

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[Any]
else:
    from cm.wire.lazy_numpy import np

Key = int | slice
LENGTH_MAX = 4 << 20  # bytes that the manager takes in one request
_WORD = 4


def describe(name: str) -> Call[MemoryInfo]:
    """The description of the memory of that name."""
    return calls.describe_memory(name)


def visible(config: ConfigInfo) -> dict[str, MemoryInfo]:
    """The memories of the current mode."""
    return {m.name: m for m in config.memories if not m.modes or config.mode in m.modes}


def dtype_of(name: str) -> np.dtype[Any]:
    """The dtype of a name, little-endian as the bus is."""
    found: np.dtype[Any] = np.dtype(name).newbyteorder("<")
    return found


def shape_of(info: MemoryInfo) -> tuple[int, ...]:
    """The shape of the whole memory."""
    return info.shape or (info.size // dtype_of(info.dtype).itemsize,)


def read(name: str, offset: int, length: int | None) -> Generator[Call[Any], Any, Array]:
    """`length` bytes (None: the rest) as an array: of the memory's shape if it is the whole, else of one axis."""
    if length is None:
        info: MemoryInfo = yield describe(name)
        length = info.size - offset
        if length <= 0:
            raise InvalidRequest(f"memory {name!r}: offset {offset} is not in it; it has {info.size} bytes")
    if length <= 0:
        raise InvalidRequest(f"memory {name!r}: {length} bytes from offset {offset} on are none")
    if length > LENGTH_MAX:
        return (yield from _read_parts(name, offset, length))
    frame, payload = yield calls.read_memory(name, offset, length)
    return np.array(_array(payload, frame))


def _read_parts(name: str, offset: int, length: int) -> Generator[Call[Any], Any, Array]:
    """A read that is longer than one answer may be."""
    info: MemoryInfo = yield describe(name)
    if offset + length > info.size:
        raise InvalidRequest(f"memory {name!r}: {length} bytes at offset {offset}; it has {info.size}")
    data = np.empty(length, np.uint8)
    for start in range(0, length, LENGTH_MAX):
        end = min(start + LENGTH_MAX, length)
        _, payload = yield calls.read_memory(name, offset + start, end - start)
        data[start:end] = np.frombuffer(payload, np.uint8)
    dtype = dtype_of(info.dtype)
    if offset % dtype.itemsize or length % dtype.itemsize:
        return data
    array = data.view(dtype)
    return array.reshape(shape_of(info)) if length == info.size else array


def _array(payload: Any, frame: FrameInfo) -> Array:
    try:
        return np.frombuffer(payload, dtype_of(frame.dtype)).reshape(frame.shape)
    except (ValueError, TypeError) as error:
        raise InvalidRequest(
            f"memory {frame.stream!r}: the answer is not a valid {frame.shape} {frame.dtype}: {error}"
        ) from error


def write(name: str, data: Any, offset: int, lease: str) -> Generator[Call[Any], Any, int]:
    """Write an array, or bytes as they are, from `offset` on; returns how many bytes there were."""
    if not isinstance(data, (bytes, bytearray, memoryview)):
        info: MemoryInfo = yield describe(name)
        data = _converted(data, info)
    view = memoryview(data).cast("B")
    if not view.nbytes:
        raise InvalidRequest(f"memory {name!r}: there are no bytes to be written")
    for start in range(0, view.nbytes, LENGTH_MAX):
        yield calls.write_memory(name, offset + start, view[start : start + LENGTH_MAX], lease)
    return view.nbytes


def _converted(data: Any, info: MemoryInfo) -> Any:
    """Values as elements of the memory. Raises InvalidRequest if a value would be changed by this."""
    dtype, given = dtype_of(info.dtype), np.atleast_1d(data)
    if not np.can_cast(given.dtype, dtype, "same_kind") and given.dtype.kind not in "iub":
        raise InvalidRequest(f"memory {info.name!r} has {info.dtype}, not {given.dtype}: convert with astype()")
    with np.errstate(all="ignore"):
        array = np.ascontiguousarray(given, dtype)
    if dtype.kind in "iub" and not np.array_equal(array, given):
        raise InvalidRequest(f"memory {info.name!r} has {info.dtype}: a value does not fit")
    if dtype.kind in "fc" and not np.array_equal(np.isfinite(array), np.isfinite(given)):
        raise InvalidRequest(f"memory {info.name!r} has {info.dtype}: a value is beyond its range")
    return array.reshape(-1).view(np.uint8).data if array.size else b""


def get(name: str, key: Key) -> Generator[Call[Any], Any, Any]:
    """``array[key]`` of the whole memory, reading no more than is needed."""
    info: MemoryInfo = yield describe(name)
    start, count, row = _rows(info, key)
    dtype, shape = dtype_of(info.dtype), shape_of(info)
    if not count:
        return np.empty((0, *shape[1:]), dtype)
    first, end = start * row // _WORD * _WORD, -(-(start + count) * row // _WORD) * _WORD
    data: Array = yield from read(name, first, end - first)
    inside = start * row - first
    rows = data.reshape(-1).view(np.uint8)[inside : inside + count * row].view(dtype).reshape(count, *shape[1:])
    return rows if isinstance(key, slice) else rows[0]


def put(name: str, key: Key, data: Any, lease: str = "") -> Generator[Call[Any], Any, None]:
    """Do ``array[key] = data``, by whole words."""
    info: MemoryInfo = yield describe(name)
    start, count, row = _rows(info, key)
    if start * row % _WORD or count * row % _WORD:
        least = _WORD // math.gcd(_WORD, row)
        raise InvalidRequest(f"memory {name!r}: writes have whole words, so begin and end at multiples of {least}")
    shape = (count, *shape_of(info)[1:]) if isinstance(key, slice) else shape_of(info)[1:]
    try:
        values = np.broadcast_to(np.asarray(data), shape)
    except ValueError as error:
        raise InvalidRequest(f"memory {name!r}: {np.shape(data)} for {shape}: {error}") from error
    if count:
        yield from write(name, values, start * row, lease)


def _rows(info: MemoryInfo, key: Key) -> tuple[int, int, int]:
    """First index on the first axis, how many, and the bytes of each. Raises InvalidRequest, IndexError."""
    shape = shape_of(info)
    row = info.size // shape[0]
    if isinstance(key, slice):
        start, stop, step = key.indices(shape[0])
        if step != 1:
            raise InvalidRequest(f"memory {info.name!r}: a step of {step}; slices of memories have none")
        return start, max(stop - start, 0), row
    index = key + shape[0] if key < 0 else key
    if not 0 <= index < shape[0]:
        raise IndexError(f"memory {info.name!r}: index {key} of {shape[0]}")
    return index, 1, row
