# SPDX-License-Identifier: Apache-2.0
"""Widths of VHDL subtype indications: std_logic and its vectors, and subtypes made of them."""

from __future__ import annotations

import re
from collections.abc import Mapping

from cm.design.hdl.vhdl_expr import Unknown, Value, integer

Subtypes = Mapping[str, str]
_BITS = ("std_logic", "std_ulogic", "bit")
_VECTORS = (
    *("std_logic_vector", "std_ulogic_vector", "bit_vector"),
    *("unsigned", "signed", "u_unsigned", "u_signed"),
)
_INDICATION = re.compile(r"([\w.]+)\s*(?:\((.*)\))?\s*", re.DOTALL)
_RANGE = re.compile(r"(.*?)\s+(downto|to)\s+(.*)", re.DOTALL | re.IGNORECASE)
_MAX_WIDTH = 1 << 24
_MAX_CHAIN = 16


class NotFlat(Unknown):
    """The type is not a vector of bits, whatever the values of the generics."""


def width_of(indication: str, names: Mapping[str, Value | None], subtypes: Subtypes, depth: int = 0) -> int:
    """Return the bits of a port of this subtype. Raises `NotFlat`, or `Unknown` for a range without a value."""
    match = _INDICATION.fullmatch(indication.strip())
    if match is None or depth > _MAX_CHAIN:
        raise NotFlat(f"its type {indication} needs a flat wrapper")
    kind = match[1].lower().rpartition(".")[2]
    if kind in _BITS:
        return 1
    if kind in _VECTORS:
        return _vector(indication, match[2], names)
    if kind in subtypes:
        return width_of(subtypes[kind], names, subtypes, depth + 1)
    raise NotFlat(f"its type {indication} is not a vector of std_logic: needs a flat wrapper")


def base_type(indication: str, subtypes: Subtypes, depth: int = 0) -> str:
    """The type behind subtypes, in lower case: ``std_logic_vector``, ``unsigned`` …"""
    kind = indication.partition("(")[0].strip().lower().rpartition(".")[2]
    if kind in subtypes and depth < _MAX_CHAIN:
        return base_type(subtypes[kind], subtypes, depth + 1)
    return kind


def _vector(indication: str, inside: str | None, names: Mapping[str, Value | None]) -> int:
    match = _RANGE.fullmatch(inside.strip()) if inside else None
    if match is None:
        raise NotFlat(f"its type {indication} has no range that could be evaluated: needs a flat wrapper")
    left, right = integer(match[1], names), integer(match[3], names)
    high, low = (left, right) if match[2].lower() == "downto" else (right, left)
    if high - low + 1 > _MAX_WIDTH:
        raise Unknown(f"its range {inside} is too wide")
    return max(high - low + 1, 0)
