# SPDX-License-Identifier: Apache-2.0
"""UIO devices: look-ups in sysfs, registers, the interrupt."""

from __future__ import annotations

from typing import NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, encode, last_error, owned, wait

Buffer = bytes | bytearray | memoryview
LIST_ROOM = 64
read32, write = lib.cm_uio_read32, lib.cm_uio_write  # below 0: an error, which `last_error` has
_VALUE = ffi.typeof("uint64_t *")


class UioMap(NamedTuple):
    """One window: physical ``address``, ``size`` in bytes, ``offset`` of its start in the mapping."""

    name: str
    address: int
    size: int
    offset: int


class UioInfo(NamedTuple):
    """A UIO device as sysfs describes it; ``node`` is "uioN"."""

    number: int
    name: str
    maps: tuple[UioMap, ...]

    @property
    def node(self) -> str:
        """Name of the node in /dev."""
        return f"uio{self.number}"


def _text(array: Handle) -> str:
    return bytes(ffi.string(array)).decode("utf-8", "replace")


def _info(info: Handle) -> UioInfo:
    maps = [info.maps[index] for index in range(info.map_count)]
    return UioInfo(
        info.number, _text(info.name), tuple(UioMap(_text(m.name), m.address, m.size, m.offset) for m in maps)
    )


def describe(root: str, number: int) -> UioInfo:
    """Return what sysfs says of uio``number``; FileNotFoundError if there is none."""
    info = ffi.new("struct cm_uio_info *")
    check(lib.cm_uio_describe(encode(root), number, info))
    return _info(info)


def numbers(root: str) -> list[int]:
    """Return the numbers of all UIO devices, ascending."""
    room = LIST_ROOM
    while True:
        array = ffi.new("unsigned int[]", room)
        found = check(lib.cm_uio_list(encode(root), array, room))
        if found <= room:
            return list(array[0:found])
        room = found


def find_name(root: str, name: str) -> UioInfo:
    """Return the first device of that name, or uioN; FileNotFoundError if there is none."""
    info = ffi.new("struct cm_uio_info *")
    check(lib.cm_uio_find_name(encode(root), encode(name), info))
    return _info(info)


def find_address(root: str, address: int, length: int) -> tuple[UioInfo, int]:
    """Return the device and map that cover the range; FileNotFoundError if none does."""
    info, index = ffi.new("struct cm_uio_info *"), ffi.new("unsigned int *")
    check(lib.cm_uio_find_address(encode(root), address, length, info, index))
    return _info(info), index[0]


def open_number(root: str, number: int) -> Handle:
    """Open /dev/uio``number`` and map its windows."""
    return owned(lib.cm_uio_open(encode(root), number), lib.cm_uio_close, f"{root}/dev/uio{number}")


def release(handle: Handle) -> None:
    """Close the device; later calls raise OSError with EBADF."""
    lib.cm_uio_release(handle)


def event_fd(handle: Handle) -> int:
    """Return the descriptor that polls readable when an interrupt waits."""
    return check(lib.cm_uio_event_fd(handle))


def read(handle: Handle, index: int, offset: int, width: int) -> int:
    """Read one register of ``width`` bits."""
    if width <= 32:
        found = read32(handle, index, offset, width)
        if found < 0:
            raise last_error()
        return found  # type: ignore[no-any-return]
    value = ffi.new(_VALUE)
    if lib.cm_uio_read(handle, index, offset, width, value) < 0:
        raise last_error()
    return int(value[0])


def read_block(handle: Handle, index: int, offset: int, length: int) -> bytearray:
    """Read ``length`` bytes as words of 32 bits; other threads of Python run meanwhile."""
    data = bytearray(length)
    check(lib.cm_uio_read_block(handle, index, offset, ffi.from_buffer(data), length))
    return data


def write_block(handle: Handle, index: int, offset: int, data: Buffer) -> None:
    """Write bytes as words of 32 bits; other threads of Python run meanwhile."""
    with ffi.from_buffer(data) as view:  # left in an error's frames, it and a memoryview cannot be garbage together
        check(lib.cm_uio_write_block(handle, index, offset, view, len(view)))


def enable_interrupt(handle: Handle) -> None:
    """Let the next interrupt through."""
    check(lib.cm_uio_enable_interrupt(handle))


def take(handle: Handle) -> int | None:
    """Return the interrupt count if one came since the last take, else None."""
    count = ffi.new("uint32_t *")
    return int(count[0]) if check(lib.cm_uio_take(handle, count)) else None


def wait_interrupt(handle: Handle, timeout: float | None) -> int:
    """Wait for an interrupt and return the count; TimeoutError."""
    count = ffi.new("uint32_t *")
    wait(lambda left: lib.cm_uio_wait(handle, left, count), timeout)
    return int(count[0])
