# SPDX-License-Identifier: Apache-2.0
"""What a plain YAML scalar means: the core schema of YAML 1.2, with `0b` and `_` in addition.

YAML 1.1 would read ``7:4`` as 424, ``010`` as 8 and ``no`` as false; in a file of addresses and
bit ranges those are traps. Here ``7:4`` and ``no`` are text, and ``010`` is refused.
"""

from __future__ import annotations

import math
import re
from typing import Any

_INTEGER = re.compile(r"[+-]?(?:0|[1-9][0-9_]*|0x[0-9A-Fa-f_]+|0o[0-7_]+|0b[01_]+)")
_FLOAT = re.compile(r"[+-]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][+-]?[0-9]+)?")
_LEADING_ZERO = re.compile(r"[+-]?0[0-9_]+")
_WORDS: dict[str, Any] = {"": None, "~": None}
_WORDS |= dict.fromkeys(("null", "Null", "NULL"))
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True) | dict.fromkeys(("false", "False", "FALSE"), False)
_LONGEST_NUMBER = 80  # digits of a 64-bit number in binary, with underscores


def resolve(text: str) -> Any:
    """The value of the plain scalar `text`: None, bool, int, float or str."""
    if text in _WORDS:
        return _WORDS[text]
    if len(text) > _LONGEST_NUMBER:
        return text
    if _INTEGER.fullmatch(text) and text[-1] != "_":
        return _integer(text)
    if _FLOAT.fullmatch(text):
        value = float(text)
        return value if math.isfinite(value) else text
    return text


def is_octal_trap(text: str) -> bool:
    """Whether `text` is a number with a leading zero, which readers of YAML disagree about."""
    return _LEADING_ZERO.fullmatch(text) is not None


def _integer(text: str) -> Any:
    try:
        return int(text.replace("_", ""), 0)
    except ValueError:  # "0x_" has no digits
        return text
