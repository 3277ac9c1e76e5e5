# SPDX-License-Identifier: Apache-2.0
"""Evaluates the VHDL expressions in port ranges and generic defaults (IEEE 1076-2008, clause 9).

Supported are integers, reals, booleans and strings, all operators except shifts, a few functions of
ieee.math_real, and the usual names of ceil(log2(n)). Anything else raises `Unknown`.

Widths of VHDL subtype indications: std_logic and its vectors, and subtypes made of them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

Value = int | float | bool | str
_TOKEN = re.compile(
    r"\s*(?:(?P<based>\d[\d_]*#[0-9a-fA-F_]+#)|(?P<real>\d[\d_]*\.\d[\d_]*(?:[eE][+-]?\d+)?)"
    r"|(?P<int>\d[\d_]*(?:[eE]\+?\d+)?)|(?P<bits>[xXbBoO]\"[0-9a-fA-F_]*\")|(?P<string>\"(?:[^\"]|\"\")*\")"
    r"|(?P<char>'.')|(?P<name>[A-Za-z]\w*(?:\.[A-Za-z]\w*)*)|(?P<op>\*\*|/=|<=|>=|[-+*/&=<>(),]))"
)
_MAX_DEPTH = 100
_MAX_POWER = 4096


class Unknown(ValueError):
    """The expression cannot be evaluated; the sentence says why."""


def _clog2(value: float) -> int:
    if value < 1:
        raise Unknown("logarithm of a number below 1")
    return (int(value) - 1).bit_length()


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
_BINDING = {  # VHDL's operator levels, loosest first
    **dict.fromkeys(("and", "or", "xor"), 1),
    **dict.fromkeys(("=", "/=", "<", "<=", ">", ">="), 2),
    **dict.fromkeys(("+", "-", "&"), 3),
    **dict.fromkeys(("*", "/", "mod", "rem"), 4),
    "**": 5,
}


def evaluate(text: str, names: Mapping[str, Value | None]) -> Value:
    """The value of an expression; `names` (lower case) are generics and constants. Raises `Unknown`."""
    try:
        return _Parser(text, names).whole()
    except (ArithmeticError, TypeError) as error:
        raise Unknown(f"{text.strip()}: {error}") from error
    except ValueError as error:
        raise error if isinstance(error, Unknown) else Unknown(f"{text.strip()}: {error}") from error


def integer(text: str, names: Mapping[str, Value | None]) -> int:
    """Do as `evaluate`, where only an integer is acceptable."""
    value = evaluate(text, names)
    if isinstance(value, bool) or not isinstance(value, int):
        raise Unknown(f"{text.strip()} is not an integer")
    return value


class _Parser:
    """Precedence climbing over the tokens of one expression."""

    def __init__(self, text: str, names: Mapping[str, Value | None]) -> None:
        self._tokens = _tokens(text)
        self._names = names
        self._next = 0
        self._depth = 0

    def whole(self) -> Value:
        value = self._binary(0)
        if self._next < len(self._tokens):
            raise Unknown(f"{self._tokens[self._next][1]!r} is not understood here")
        return value

    def _peek(self) -> tuple[str, str]:
        return self._tokens[self._next] if self._next < len(self._tokens) else ("end", "")

    def _take(self, text: str = "") -> tuple[str, str]:
        token = self._peek()
        if token[0] == "end" or (text and token[1] != text):
            raise Unknown(f"{text or 'a value'} is missing")
        self._next += 1
        return token

    def _binary(self, level: int) -> Value:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise Unknown("too deeply nested")
        left = self._unary()
        while (binding := _BINDING.get(self._peek()[1].lower(), 0)) > level:
            operator = self._take()[1].lower()
            left = _apply(operator, left, self._binary(binding))
        self._depth -= 1
        return left

    def _unary(self) -> Value:
        word = self._peek()[1].lower()
        if word in ("-", "+", "not", "abs"):
            self._take()
            # A sign binds looser than * in VHDL; `not` and `abs` bind tightest.
            value = self._binary(3 if word in "+-" else 5)
            return _sign(word, value)
        return self._primary()

    def _primary(self) -> Value:
        kind, text = self._take()
        if text == "(":
            value = self._binary(0)
            self._take(")")
            return value
        if kind == "name":
            return self._name(text)
        if kind == "op":
            raise Unknown(f"{text!r} is not understood here")
        return _literal(kind, text)

    def _name(self, text: str) -> Value:
        name = text.lower().rpartition(".")[2]
        if self._peek()[1] == "(":
            return self._call(name)
        if name in ("true", "false"):
            return name == "true"
        value = self._names.get(name)
        if value is None:
            raise Unknown(f"the value of {text} is not known")
        return value

    def _call(self, name: str) -> Value:
        function = _FUNCTIONS.get(name)
        if function is None:
            raise Unknown(f"the function {name} is not evaluated")
        self._take("(")
        arguments = [self._binary(0)]
        while self._peek()[1] == ",":
            self._take()
            arguments.append(self._binary(0))
        self._take(")")
        return function(*arguments)


def _tokens(text: str) -> list[tuple[str, str]]:
    tokens, position, text = [], 0, text.strip()
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None or match.lastgroup is None:
            raise Unknown(f"{text[position : position + 10]!r} is not understood")
        tokens.append((match.lastgroup, match.group(match.lastgroup)))
        position = match.end()
    return tokens


def _literal(kind: str, text: str) -> Value:
    plain = text.replace("_", "")
    if kind == "based":
        base, digits, _ = plain.split("#")
        return int(digits, int(base))
    if kind == "int":
        mantissa, _, exponent = plain.lower().partition("e")
        if int(exponent or 0) > _MAX_POWER:
            raise Unknown(f"{text} is too large")
        return int(mantissa + "0" * int(exponent or 0))
    if kind == "real":
        return float(plain)
    if kind == "bits":
        return _bits(plain)
    return text[1:-1].replace('""', '"')


def _bits(text: str) -> str:
    per_digit = {"x": 4, "o": 3, "b": 1}[text[0].lower()]
    digits = text[2:-1]
    return format(int(digits or "0", 2**per_digit), f"0{len(digits) * per_digit}b") if digits else ""


def _sign(word: str, value: Value) -> Value:
    if word == "not":
        if not isinstance(value, bool):
            raise Unknown("not of a vector")
        return not value
    if isinstance(value, (str, bool)):
        raise Unknown(f"{word} of something that is not a number")
    return -value if word == "-" else abs(value) if word == "abs" else value


def _apply(operator: str, left: Value, right: Value) -> Value:
    if operator == "&":
        return str(left) + str(right)
    if operator in ("and", "or", "xor"):
        if not (isinstance(left, bool) and isinstance(right, bool)):
            raise Unknown(f"{operator} of something that is not boolean")
        return {"and": left and right, "or": left or right, "xor": left != right}[operator]
    if operator in ("=", "/="):
        return (left == right) is (operator == "=")
    if isinstance(left, str) or isinstance(right, str):
        raise Unknown(f"{operator} of a string")
    return _arithmetic(operator, left, right)


def _arithmetic(operator: str, left: int | float, right: int | float) -> Value:
    if operator == "**" and abs(right) > _MAX_POWER:
        raise Unknown("power too large")
    operations: dict[str, Callable[[], Value]] = {
        "+": lambda: left + right,
        "-": lambda: left - right,
        "*": lambda: left * right,
        "/": lambda: _divide(left, right),
        "mod": lambda: left % right,
        "rem": lambda: left - right * int(left / right),
        "**": lambda: _power(left, right),
        "<": lambda: left < right,
        "<=": lambda: left <= right,
        ">": lambda: left > right,
        ">=": lambda: left >= right,
    }
    return operations[operator]()


def _power(left: int | float, right: int | float) -> int | float:
    value: int | float = left**right
    return value


def _divide(left: int | float, right: int | float) -> int | float:
    """Integer division truncates towards zero (IEEE 1076, 9.2.7)."""
    if isinstance(left, int) and isinstance(right, int):
        quotient = abs(left) // abs(right)
        return quotient if (left < 0) == (right < 0) else -quotient
    return left / right


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
