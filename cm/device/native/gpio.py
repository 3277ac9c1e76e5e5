# SPDX-License-Identifier: Apache-2.0
"""Lines of GPIO chips (linux/gpio.h, uAPI v2): errno becomes OSError."""

from __future__ import annotations

from typing import NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, encode, owned


class ChipInfo(NamedTuple):
    """``struct gpiochip_info``."""

    name: str
    label: str
    lines: int


def chip_info(root: str, name: str) -> ChipInfo:
    """What the chip /dev/``name`` is."""
    info = ffi.new("struct gpiochip_info *")
    check(lib.cm_gpio_chip_info(encode(root), encode(name), info))
    return ChipInfo(_text(info.name), _text(info.label), info.lines)


def _text(field: Handle) -> str:
    return bytes(ffi.string(field)).decode("utf-8", "replace")


def find_line(root: str, name: str, line: str) -> int:
    """The place in chip /dev/``name`` of the line with a name; ENOENT for none, ENOTUNIQ for several."""
    offset = ffi.new("uint32_t *")
    check(lib.cm_gpio_line_find(encode(root), encode(name), encode(line), offset))
    return int(offset[0])


def open_line(root: str, name: str, offset: int, consumer: str, active_low: bool = False) -> Handle:
    """Take line ``offset`` of the chip /dev/``name``, as it is."""
    pointer = lib.cm_gpio_line_open(encode(root), encode(name), offset, encode(consumer), active_low)
    return owned(pointer, lib.cm_gpio_line_close, f"{root}/dev/{name}")


def release(handle: Handle) -> None:
    """Give the line back; later calls raise OSError with EBADF."""
    lib.cm_gpio_line_release(handle)


def event_fd(handle: Handle) -> int:
    """Return the line's descriptor."""
    return check(lib.cm_gpio_line_event_fd(handle))


def get(handle: Handle) -> int:
    """Return the line's value, 0 or 1."""
    return check(lib.cm_gpio_line_get(handle))


def drive(handle: Handle, value: int) -> None:
    """Make it an output with this value."""
    check(lib.cm_gpio_line_drive(handle, value))
