# SPDX-License-Identifier: Apache-2.0
"""Widths of C++ types as HLS knows them: integers, the ap_ types, streams of packets, typedefs and macros."""

from __future__ import annotations

import ast
import re
import shlex
from dataclasses import dataclass

_WIDTHS = {
    "bool": 1,
    "char": 8,
    "short": 16,
    "int": 32,
    "unsigned": 32,
    "long": 64,
    "long long": 64,
    "size_t": 64,
    "float": 32,
    "double": 64,
    "half": 16,
    "signed": 32,
    **{f"{sign}int{bits}_t": bits for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
_NOISE = re.compile(r"\b(?:(?:const|volatile|static|struct|typename)\b|std::|hls::(?=stream|axis))|[&*\s]+$")
_TEMPLATE = re.compile(r"([\w:]+)\s*<(.*)>$", re.DOTALL)
_OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.LShift, ast.RShift, ast.Mod)
_MAX_DEPTH = 16
_MAX_WIDTH = 1 << 16


@dataclass(frozen=True, slots=True)
class Packet:
    """What a stream carries: bits of data and, with `sideband`, TKEEP, TSTRB, TLAST and the bits of the others."""

    data: int
    sideband: bool = False
    user: int = 0
    id: int = 0
    dest: int = 0


class Types:
    """Names of a translation unit."""

    def __init__(self, text: str, cflags: str = "") -> None:
        self._values = dict(re.findall(r"^\s*#\s*define\s+(\w+)\s+(\S[^\n]*?)\s*$", text, re.MULTILINE))
        self._values |= dict(re.findall(r"\b(?:const|constexpr)\s+[\w\s]+?\b(\w+)\s*=\s*([^;{]+);", text))
        for flag in _flags(cflags):
            name, _, value = flag[2:].partition("=")
            if flag.startswith("-D"):
                self._values[name] = value or "1"
        self._types = {name: kind for kind, name in re.findall(r"\btypedef\s+([^;{}]+?)\s*\b(\w+)\s*;", text)}
        self._types |= dict(re.findall(r"\busing\s+(\w+)\s*=\s*([^;]+);", text))

    def width(self, kind: str, depth: int = 0) -> int | None:
        """Bits of a type; None where it is not known."""
        text = _plain(kind)
        if depth > _MAX_DEPTH:
            return None
        known = _WIDTHS.get(re.sub(r"\b(?:un)?signed (?=\w)|(?<=long) int|(?<=short) int", "", text))
        if known:
            return known
        if text in self._types or text in self._values:
            return self.width(self._types.get(text) or self._values[text], depth + 1)
        template = _TEMPLATE.fullmatch(text)
        if template and template[1].startswith(("ap_uint", "ap_int", "ap_ufixed", "ap_fixed")):
            return self.number(first_of(template[2]))
        return None

    def stream(self, kind: str, depth: int = 0) -> Packet | None:
        """What an hls::stream carries; None for another type."""
        text = _plain(kind)
        if text in self._types and depth < _MAX_DEPTH:
            return self.stream(self._types[text], depth + 1)
        template = _TEMPLATE.fullmatch(text)
        if template is None or template[1] != "stream":
            return None
        return self.packet(first_of(template[2]))

    def packet(self, kind: str, depth: int = 0) -> Packet | None:
        """A word of a stream: ap_axiu, ap_axis, hls::axis with their side-band signals, or plain data."""
        text = _plain(kind)
        if text in self._types and depth < _MAX_DEPTH:
            return self.packet(self._types[text], depth + 1)
        template = _TEMPLATE.fullmatch(text)
        if template and template[1] in ("ap_axiu", "ap_axis", "axis", "axis_data"):
            first, *rest = split(template[2]) or [""]
            data = self.width(first) if template[1] in ("axis", "axis_data") else self.number(first)
            numbers = [self.number(part) or 0 for part in rest[:3]] + [0, 0, 0]
            return Packet(data, True, *numbers[:3]) if data else None
        data = self.width(kind)
        return Packet(data) if data else None

    def number(self, text: str, depth: int = 0) -> int | None:
        """The value of a constant expression."""
        words = re.sub(r"\b(\d+)[uUlL]+\b", r"\1", text)
        for name in set(re.findall(r"[A-Za-z_]\w*", words)):
            value = self.number(self._values[name], depth + 1) if name in self._values and depth < _MAX_DEPTH else None
            if value is None:
                return None
            words = re.sub(rf"\b{name}\b", str(value), words)
        try:
            return _evaluate(ast.parse(words.strip(), mode="eval").body)
        except (SyntaxError, ValueError, ZeroDivisionError, RecursionError, OverflowError):
            return None


def _plain(kind: str) -> str:
    """Return a type without the qualifiers that do not affect its width."""
    return " ".join(_NOISE.sub(" ", kind).split())


def _evaluate(node: ast.expr) -> int:
    if isinstance(node, ast.Constant) and isinstance(node.value, int):
        return node.value
    if isinstance(node, ast.BinOp) and isinstance(node.op, _OPERATORS):
        left, right = _evaluate(node.left), _evaluate(node.right)
        if isinstance(node.op, (ast.Div, ast.FloorDiv)):
            return left // right
        if isinstance(node.op, ast.LShift):
            value = left << min(right, 32)
        elif isinstance(node.op, ast.RShift):
            value = left >> right
        elif isinstance(node.op, ast.Mod):
            value = left % right
        else:
            value = left + right if isinstance(node.op, ast.Add) else left - right
            value = left * right if isinstance(node.op, ast.Mult) else value
        if abs(value) > _MAX_WIDTH:
            raise ValueError
        return value
    raise ValueError


def first_of(text: str) -> str:
    """The first of a template's arguments; empty if there is none."""
    return next(iter(split(text)), "")


def split(text: str, separator: str = ",") -> list[str]:
    """Split at the separators that are outside all brackets."""
    parts, depth, start = [], 0, 0
    for index, letter in enumerate(text):
        depth += (letter in "<([{") - (letter in ">)]}")
        if letter == separator and depth == 0:
            parts.append(text[start:index].strip())
            start = index + 1
    parts.append(text[start:].strip())
    return [part for part in parts if part]


def _flags(cflags: str) -> list[str]:
    try:
        return shlex.split(cflags)
    except ValueError:
        return cflags.split()
