# SPDX-License-Identifier: Apache-2.0
"""What the board measures: temperatures, voltages, currents and powers, from hwmon and IIO in sysfs.

Both have their units in the kernel's documentation: Documentation/hwmon/sysfs-interface.rst (thousandths of a degree
Celsius, of a volt and of an ampere, millionths of a watt) and Documentation/ABI/testing/sysfs-bus-iio (the same, for
(`raw` + `offset`) × `scale`). Zynq-7000's XADC and Zynq UltraScale+'s AMS belong to IIO, the power monitors of boards
(INA226, IRPS5401) to hwmon.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path

from cm.device.paths import Root
from cm.frozen import dataclass

HWMON, IIO = "sys/class/hwmon", "sys/bus/iio/devices"
_MOST = 64  # readings of a board, so that its status stays short
_TEXT_MAX = 64  # characters of a name
_HWMON = re.compile(r"(temp|in|curr|power)(\d+)_input")
_IIO = re.compile(r"in_(temp|voltage|current|power)(\d*)(?:_(\w+?))?_(raw|input)")
_QUANTITIES = {"temp": "temperature", "in": "voltage", "curr": "current", "power": "power"}
_QUANTITIES |= {"voltage": "voltage", "current": "current"}
_HWMON_UNITS = {"temp": 1e-3, "in": 1e-3, "curr": 1e-3, "power": 1e-6}


@dataclass(frozen=True, slots=True)
class Reading:
    """A measured value in °C, V, A or W; `quantity` is temperature, voltage, current or power."""

    device: str  # as its driver calls it
    name: str  # of the channel on that device: its label where it has one
    quantity: str
    value: float


def read_sensors(root: Root | None = None) -> tuple[Reading, ...]:
    """All that can be read now, in the order of the devices; a channel that cannot is left out, and never raises."""
    board = root or Root.of(None)
    found = list(_hwmon(board)) + list(_iio(board))
    return tuple(found[:_MOST])


def _hwmon(root: Root) -> Iterator[Reading]:
    for folder in _folders(root.join(HWMON)):
        device = _text(folder / "name") or folder.name
        for path, match in _channels(folder, _HWMON):
            kind, number = match.groups()
            value = _number(path)
            if value is not None:
                name = _text(folder / f"{kind}{number}_label") or f"{kind}{number}"
                yield Reading(device, name, _QUANTITIES[kind], value * _HWMON_UNITS[kind])


def _iio(root: Root) -> Iterator[Reading]:
    for folder in _folders(root.join(IIO)):
        device = _text(folder / "name") or folder.name
        for path, match in _channels(folder, _IIO):
            kind, number, extended, form = match.groups()
            value = _number(path)
            if value is None:
                continue
            if form == "raw":
                value = (value + _of_channel(folder, path, kind, "offset", 0.0)) * _of_channel(
                    folder, path, kind, "scale", 1.0
                )
            channel = path.name.removeprefix("in_").removesuffix(f"_{form}")
            name = _text(folder / f"in_{channel}_label") or extended or f"{kind}{number}"
            yield Reading(device, name, _QUANTITIES[kind], value * 1e-3)


def _of_channel(folder: Path, path: Path, kind: str, what: str, otherwise: float) -> float:
    """An attribute of a channel, or the one that all of its kind share."""
    own = _number(path.with_name(path.name.rpartition("_")[0] + f"_{what}"))
    shared = _number(folder / f"in_{kind}_{what}") if own is None else own
    return otherwise if shared is None else shared


def _folders(place: Path) -> list[Path]:
    try:
        return sorted(place.iterdir(), key=_by_number)
    except OSError:
        return []


def _channels(folder: Path, pattern: re.Pattern[str]) -> Iterator[tuple[Path, re.Match[str]]]:
    try:
        paths = sorted(folder.iterdir(), key=_by_number)
    except OSError:
        return
    for path in paths:
        match = pattern.fullmatch(path.name)
        if match:
            yield path, match


def _by_number(path: Path) -> list[tuple[int, str]]:
    """temp2 before temp10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(4 * _TEXT_MAX).decode("utf-8", "replace").strip()[:_TEXT_MAX]
    except OSError:
        return ""


def _number(path: Path) -> float | None:
    """None if there is none: a channel that is switched off gives an error."""
    try:
        value = float(_text(path))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
