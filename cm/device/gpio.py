# SPDX-License-Identifier: Apache-2.0
"""Lines of GPIO chips, through the kernel's character device."""

from __future__ import annotations

import errno
from typing import ClassVar

from cm.device import advice
from cm.device.base import AnyRoot, Device, Shim
from cm.device.errors import device_error
from cm.device.native import gpio as native
from cm.device.native.call import Handle
from cm.device.paths import Root
from cm.frozen import dataclass

CONSUMER = "fpga-cm"  # what gpioinfo(1) says of a line that is held


@dataclass(frozen=True, slots=True)
class GpioChip:
    """A chip: its name in /dev, what its driver calls it, and how many lines it has."""

    name: str
    label: str
    lines: int


def list_gpio(root: AnyRoot = None) -> list[GpioChip]:
    """Return the chips that may be opened, by name."""
    base = Root.of(root)
    return [chip for name in _names(base) if (chip := _chip(base, name)) is not None]


def _names(root: Root) -> list[str]:
    return [name for name in advice.names(root.join("dev")) if name.startswith("gpiochip")]


def _chip(root: Root, name: str) -> GpioChip | None:
    try:
        info = native.chip_info(root.prefix, name)
    except OSError:
        return None
    return GpioChip(name, info.label, info.lines)


class GpioLine(Device):
    """One line, held from `open` to `close`: no other process gets it, and the value that it drives stays.

    Opening changes neither its direction nor its value.
    """

    _shim: ClassVar[Shim] = native

    @classmethod
    def open(cls, chip: str, line: int | str, root: AnyRoot = None, active_low: bool = False) -> GpioLine:
        """Take line `line` of a chip, by the chip's label or its name; a line by its place or its own name.

        Names of lines are those of `gpio-line-names` in the device tree. With `active_low`, 1 is a low level.

        Raises DeviceNotFound, DeviceBusy where another holds the line, DeviceInvalid where the chip has none of that
        number or several chips have that label, DevicePermission.
        """
        base = Root.of(root)
        name = _find(base, chip)
        path = base.join("dev", name)
        what = f"{path} line {line}"
        place = _place(base, name, line, what) if isinstance(line, str) else line
        return cls(_opened(base, name, place, what, active_low), path)

    @property
    def value(self) -> int:
        """0 or 1, as the chip reads it."""
        try:
            return native.get(self._handle)
        except OSError as error:
            raise self._error(error, "read a line of") from error

    @value.setter
    def value(self, value: int) -> None:
        """Make the line an output with this value."""
        try:
            native.drive(self._handle, int(value))
        except (OSError, OverflowError) as error:
            raise self._error(error, "drive a line of") from error


def _place(root: Root, name: str, line: str, what: str) -> int:
    """The place of a line in its chip."""
    try:
        return native.find_line(root.prefix, name, line)
    except (OSError, ValueError) as error:
        number = error.errno if isinstance(error, OSError) and error.errno else errno.EINVAL
        hints = {
            errno.ENOENT: "the chip has no line of that name; gpioinfo lists them",
            errno.ENOTUNIQ: "the chip has several lines of that name: say the number",
        }
        raise device_error(number, "open", what, hints.get(number, "")) from error


def _opened(root: Root, name: str, line: int, what: str, active_low: bool) -> Handle:
    try:
        return native.open_line(root.prefix, name, line, CONSUMER, active_low)
    except OverflowError as error:
        raise device_error(errno.EINVAL, "open", what, "a line's number is 0 or more") from error
    except OSError as error:
        raise device_error(error, "open", what, _hint(error, root, name)) from error


def _hint(error: OSError, root: Root, name: str) -> str:
    if error.errno == errno.EBUSY:
        return "it is in use; gpioinfo shows by whom"
    if error.errno == errno.EINVAL and (chip := _chip(root, name)) is not None:
        return f"{name} ({chip.label}) has lines 0 to {chip.lines - 1}"
    return advice.unopened(error, root, root.join("dev", name), _names(root))


def _find(root: Root, chip: str) -> str:
    """The name in /dev of the chip with a name or label."""
    present = _names(root)
    if chip in present:
        return chip
    found = list_gpio(root)
    labelled = [known.name for known in found if known.label == chip]
    if len(labelled) == 1:
        return labelled[0]
    if labelled:
        hint = f"{', '.join(labelled)} have that label: say which one"
        raise device_error(errno.EINVAL, "open", f"GPIO chip {chip}", hint)
    closed = [root.join("dev", name) for name in present if name not in {known.name for known in found}]
    hint = f"there are: {', '.join(f'{known.name} ({known.label})' for known in found) or 'none'}"
    if closed:
        hint += f"; {closed[0].name} could not be asked: {advice.permission(closed[0])}"
    raise device_error(errno.ENOENT, "open", f"GPIO chip {chip}", hint)
