# SPDX-License-Identifier: Apache-2.0
"""VHDL expressions of generics and ranges, as far as an interface needs them; tree-sitter parses them.

Supported are integers, reals, booleans and strings, all operators except shifts, a few functions of
ieee.math_real, and the usual names of ceil(log2(n)). Anything else raises `Unknown`.

Widths of VHDL subtype indications: std_logic and its vectors, and subtypes made of them.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from cm.design.hdl.errors import parser_missing

Value = int | float | bool | str
_MAX_POWER = 4096
_BEFORE = b"package p is constant c : t := "  # what an expression is parsed behind


class Unknown(ValueError):
    """The expression cannot be evaluated; the sentence says why."""


@lru_cache(maxsize=1)
def load_parser() -> Any:
    """A tree-sitter parser for VHDL; `ParserMissing` where it is not installed."""
    try:
        import tree_sitter
        import tree_sitter_vhdl
    except ImportError as error:
        raise parser_missing("tree-sitter-vhdl", "VHDL") from error
    return tree_sitter.Parser(tree_sitter.Language(tree_sitter_vhdl.language()))


def _clog2(value: float) -> int:
    if value < 1:
        raise Unknown("logarithm of a number below 1")
    return (int(value) - 1).bit_length()


def _divide(left: int | float, right: int | float) -> int | float:
    """Integer division truncates towards zero (IEEE 1076, 9.2.7)."""
    if isinstance(left, int) and isinstance(right, int):
        quotient = abs(left) // abs(right)
        return quotient if (left < 0) == (right < 0) else -quotient
    return left / right


def _power(left: int | float, right: int | float) -> Value:
    if abs(right) > _MAX_POWER:
        raise Unknown("power too large")
    value: Value = left**right
    return value


_FUNCTIONS: Mapping[str, Callable[..., Value]] = {
    **dict.fromkeys(("integer", "natural", "positive"), lambda x: math.floor(x + 0.5)),  # conversion rounds
    "real": float,
    "ceil": lambda x: float(math.ceil(x)),
    "floor": lambda x: float(math.floor(x)),
    "log2": math.log2,
    **dict.fromkeys(("maximum", "max", "math_max"), max),
    **dict.fromkeys(("minimum", "min", "math_min"), min),
    **dict.fromkeys(("clog2", "ceil_log2", "log2ceil", "ceillog2"), _clog2),
}
_LOGICAL: Mapping[str, Callable[[bool, bool], bool]] = {"and": operator.and_, "or": operator.or_, "xor": operator.xor}
_ARITHMETIC: Mapping[str, Callable[..., Value]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": _divide,
    "**": _power,
    "mod": operator.mod,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "rem": lambda left, right: left - right * int(left / right),
}
_BIT_STRING = re.compile(r'(\d*)([us]?)([xobd])"(\w*)"')
_SIGNS: Mapping[str, Callable[..., Value]] = {"-": operator.neg, "+": operator.pos, "abs": abs}


def evaluate(text: str, names: Mapping[str, Value | None]) -> Value:
    """The value of an expression; `names` (lower case) are generics and constants. Raises `Unknown`."""
    data = text.strip().encode(errors="replace")
    span = (len(_BEFORE), len(_BEFORE) + len(data))
    root = load_parser().parse(_BEFORE + data + b"; end;").root_node
    node = root.named_descendant_for_byte_range(*span)
    if not data or root.has_error or (node.start_byte, node.end_byte) != span:
        raise Unknown(f"{text.strip()!r} is not understood" if data else "a value is missing")
    try:
        return _value(node, names)
    except (ArithmeticError, TypeError, RecursionError) as error:
        raise Unknown(f"{text.strip()}: {error}") from error
    except ValueError as error:
        raise error if isinstance(error, Unknown) else Unknown(f"{text.strip()}: {error}") from error


def integer(text: str, names: Mapping[str, Value | None]) -> int:
    """Do as `evaluate`, where only an integer is acceptable."""
    value = evaluate(text, names)
    if isinstance(value, bool) or not isinstance(value, int):
        raise Unknown(f"{text.strip()} is not an integer")
    return value


def _value(node: Any, names: Mapping[str, Value | None]) -> Value:
    parts, text = node.named_children, node.text.decode(errors="replace")
    if not parts or node.type in ("based_literal", "bit_string_literal"):
        return _literal(text) if text[0] in "\"'0123456789" or text[-1] == '"' else _named(text, names)
    kinds = [part.type for part in parts]
    if node.type == "name" and kinds[-1] == "parenthesis_group" and {*kinds[1:-1]} <= {"selection"}:
        return _call(text.partition("(")[0], parts[-1].named_children[0].named_children, names)
    if node.type == "name" and {*kinds[1:]} == {"selection"}:
        return _named(text, names)
    if len(parts) == 1:
        return _value(parts[0], names)
    if kinds[0] in ("sign", "unary_operator"):
        return _signed(parts[0].text.decode().lower(), _value(parts[1], names))
    if len(parts) == 3 and kinds[1].endswith(("_operator", "exponentiate")):
        return _apply(parts[1].text.decode().lower(), _value(parts[0], names), _value(parts[2], names))
    raise Unknown(f"{text} is not evaluated")


def _named(text: str, names: Mapping[str, Value | None]) -> Value:
    name = text.lower().rpartition(".")[2].strip()
    if name in ("true", "false"):
        return name == "true"
    value = names.get(name)
    if value is None:
        raise Unknown(f"the value of {text} is not known")
    return value


def _call(text: str, arguments: list[Any], names: Mapping[str, Value | None]) -> Value:
    name = text.lower().rpartition(".")[2].strip()
    if name not in _FUNCTIONS:
        raise Unknown(f"the function {name} is not evaluated")
    return _FUNCTIONS[name](*(_value(argument, names) for argument in arguments))


def _bits(text: str) -> str:
    """A string of bits in any base, of VHDL-2008's length (``12ux"3f"``) if it states one."""
    found = _BIT_STRING.fullmatch(text)
    if found is None:
        raise Unknown(f"{text} is not evaluated")
    length, signed, base, digits = found.groups()
    per_digit = {"x": 4, "o": 3, "b": 1, "d": 0}[base]
    value = int(digits, 2**per_digit if per_digit else 10) if digits else 0
    bits = format(value, f"0{len(digits) * per_digit}b") if digits else ""
    wanted = int(length or len(bits))
    return bits.rjust(wanted, bits[:1] if signed == "s" else "0")[max(0, len(bits) - wanted) :]


def _literal(text: str) -> Value:
    plain = text.replace("_", "").lower()
    if text[-1] in "\"'":
        if text[0] in "\"'":
            return text[1:-1].replace('""', '"')
        return _bits(plain)
    if "#" in plain:
        base, digits, _ = plain.split("#")
        return int(digits, int(base))
    mantissa, _, exponent = plain.partition("e")
    if "." in mantissa:
        return float(plain)
    if int(exponent or 0) > _MAX_POWER:
        raise Unknown(f"{text} is too large")
    return int(mantissa + "0" * int(exponent or 0))


def _signed(word: str, value: Value) -> Value:
    if word == "not" and isinstance(value, bool):
        return not value
    if word not in _SIGNS or isinstance(value, (str, bool)):
        raise Unknown(f"{word} of {value!r}")
    return _SIGNS[word](value)


def _apply(word: str, left: Value, right: Value) -> Value:
    if word == "&":
        return str(left) + str(right)
    if word in ("=", "/="):
        return (left == right) is (word == "=")
    if word in _LOGICAL and isinstance(left, bool) and isinstance(right, bool):
        return _LOGICAL[word](left, right)
    if word not in _ARITHMETIC or isinstance(left, str) or isinstance(right, str):
        raise Unknown(f"{word} of {left!r} and {right!r}")
    return _ARITHMETIC[word](left, right)


Subtypes = Mapping[str, str]
_BITS = ("std_logic", "std_ulogic", "bit")
_VECTORS = (
    *("std_logic_vector", "std_ulogic_vector", "bit_vector"),
    *("unsigned", "signed", "u_unsigned", "u_signed"),
)
_INDICATION = re.compile(r"([\w.]+)\s*(?:\((.*)\))?\s*", re.DOTALL)
_RANGE = re.compile(r"(.*?)\s+(downto|to)\s+(.*)", re.DOTALL | re.IGNORECASE)
_CONSTRAINED = re.compile(r"([\w.]+)(?:\s+range\s+(.*?)\s+(?:downto|to)\s+(.*))?", re.DOTALL | re.IGNORECASE)
_LOWEST: Mapping[str, float] = {"integer": -math.inf, "natural": 0, "positive": 1}
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
    if kind in subtypes:  # one without a range of its own takes that of its use: slv(7 downto 0)
        own = subtypes[kind]
        own += f"({match[2]})" if match[2] and "(" not in own else ""
        return width_of(own, names, subtypes, depth + 1)
    raise NotFlat(f"its type {indication} is not a vector of std_logic: needs a flat wrapper")


def base_type(indication: str, subtypes: Subtypes, depth: int = 0) -> str:
    """The type behind subtypes, in lower case: ``std_logic_vector``, ``unsigned`` …"""
    kind = indication.partition("(")[0].strip().lower().rpartition(".")[2]
    if kind in subtypes and depth < _MAX_CHAIN:
        return base_type(subtypes[kind], subtypes, depth + 1)
    return kind


def no_value_of(
    value: Value, indication: str, names: Mapping[str, Value | None], subtypes: Subtypes, depth: int = 0
) -> bool:
    """Whether a number or truth value is none of an integer type's, as 9 is none of ``natural range 1 to 8``.

    False for other types, for text, and where a bound has no value that could be evaluated.
    """
    match = _CONSTRAINED.fullmatch(indication.strip())
    if match is None or isinstance(value, str) or depth > _MAX_CHAIN:
        return False
    kind = match[1].lower().rpartition(".")[2]
    if kind in subtypes:
        wrong = no_value_of(value, subtypes[kind], names, subtypes, depth + 1)
    else:
        wrong = kind in _LOWEST and (not isinstance(value, int) or isinstance(value, bool) or value < _LOWEST[kind])
    try:
        bounds = (integer(match[2], names), integer(match[3], names)) if match[2] else (value, value)
    except Unknown:
        return wrong
    return wrong or not min(bounds) <= value <= max(bounds)


def _vector(indication: str, inside: str | None, names: Mapping[str, Value | None]) -> int:
    match = _RANGE.fullmatch(inside.strip()) if inside else None
    if match is None:
        raise NotFlat(f"its type {indication} has no range that could be evaluated: needs a flat wrapper")
    left, right = integer(match[1], names), integer(match[3], names)
    high, low = (left, right) if match[2].lower() == "downto" else (right, left)
    if high - low + 1 > _MAX_WIDTH:
        raise Unknown(f"its range {inside} is too wide")
    return max(high - low + 1, 0)
