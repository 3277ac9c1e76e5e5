# SPDX-License-Identifier: Apache-2.0
"""Values are taken literally: whatever would need a conversion is refused."""

from __future__ import annotations

import operator
from typing import Any

from cm.errors import InvalidRequest
from cm.wire.messages.requests import RegWrite

_MOST = (1 << 64) - 1


def register_value(name: str, value: Any) -> int:
    """An integer from 0 to 2**64 - 1. Raises InvalidRequest for bool, float, str and all else."""
    if isinstance(value, bool) or (type(value).__module__, type(value).__name__.rstrip("_")) == ("numpy", "bool"):
        raise InvalidRequest(f"register {name!r} takes an integer, not {value!r}: write {int(value)}")
    try:
        number = operator.index(value)
    except TypeError:
        raise InvalidRequest(f"register {name!r} takes an integer, not {value!r} ({type(value).__name__})") from None
    if not 0 <= number <= _MOST:
        bits = f"; in 32 bits that is {number & 0xFFFFFFFF:#x}" if -(1 << 31) <= number < 0 else ""
        raise InvalidRequest(f"register {name!r} takes an integer from 0 to 2**64 - 1, not {number}{bits}")
    return number


def register_write(name: str, value: Any) -> RegWrite:
    """A write of an integer, or of a field's value by its name, which the manager looks up. Raises InvalidRequest."""
    if isinstance(value, str) and value:
        return RegWrite(name, 0, named=value)
    if type(value) is int and 0 <= value <= _MOST:  # mostly
        return RegWrite(name, value)
    return RegWrite(name, register_value(name, value))


def mode_name(mode: Any) -> str:
    """The name of a mode. Raises InvalidRequest for None, the empty name and all else."""
    if not isinstance(mode, str) or not mode:
        raise InvalidRequest(f"a mode is named by a word, not {mode!r}; load(config) goes to its default mode")
    return mode
