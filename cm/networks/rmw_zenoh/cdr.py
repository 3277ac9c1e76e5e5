# SPDX-License-Identifier: Apache-2.0
"""Messages as DDS has them on the wire: XCDR1, little-endian, behind a header of four bytes. Values are plain dicts."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

from cm.errors import InvalidRequest
from cm.networks.rmw_zenoh.interfaces import Field, fields_of

HEADER = b"\0\1\0\0"
_CODES = {
    "bool": "?", "byte": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_BYTES = ("byte", "uint8")
_MOST = 1 << 26  # most elements of a sequence that is read: our messages have no longer ones

Values = Mapping[str, Any]
_Put = Callable[[bytearray, Any], None]
_Take = Callable[["Reader"], Any]


def encode(name: str, values: Values) -> bytes:
    """A message; what is left out is 0, empty or False. Raises InvalidRequest for values that do not fit."""
    out = bytearray(HEADER)
    try:
        _putter(name)(out, values)
    except (struct.error, TypeError, ValueError, AttributeError) as error:
        raise InvalidRequest(f"values do not fit {name}: {error}") from error
    return bytes(out)


def head(name: str, values: Values, length: int) -> bytearray:
    """All of a message up to the `length` bytes of its last field."""
    out = bytearray(HEADER)
    *fields, _ = fields_of(name)
    for field in fields:
        _field_putter(field)(out, values.get(field.name, _empty(field)))
    _align(out, 4)
    out.extend(struct.pack("<I", length))
    return out


def decode(name: str, data: bytes | memoryview) -> dict[str, Any]:
    """A message's values; sequences of bytes are memory of `data`. Raises InvalidRequest for what is none."""
    try:
        values: dict[str, Any] = _taker(name)(Reader(data))
    except (struct.error, IndexError, UnicodeDecodeError, ValueError) as error:
        raise InvalidRequest(f"this is not a valid {name}: {error}") from error
    return values


def decode_head(name: str, data: bytes | memoryview) -> tuple[dict[str, Any], int, int]:
    """All fields but the last, which holds bytes: how many, and where they begin. Raises InvalidRequest."""
    reader = Reader(data)
    *fields, _ = fields_of(name)
    try:
        values = {field.name: _field_taker(field)(reader) for field in fields}
        length = int(reader.take("I", 4))
    except (struct.error, IndexError, UnicodeDecodeError, ValueError) as error:
        raise InvalidRequest(f"this is not a valid {name}: {error}") from error
    return values, length, reader.at


class Reader:
    """A position in a message, of either byte order."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data = memoryview(data).cast("B")
        if len(self.data) < 4 or self.data[0] != 0 or self.data[1] not in (0, 1):
            raise InvalidRequest(f"not plain CDR: it begins with {bytes(self.data[:4]).hex(' ')}")
        self.order = "<" if self.data[1] else ">"
        self.at = 4

    def take(self, code: str, size: int) -> Any:
        """A number."""
        start = self.at + -(self.at - 4) % size
        self.at = start + size
        return struct.unpack_from(self.order + code, self.data, start)[0]

    def block(self, length: int) -> memoryview:
        """Bytes as they lie."""
        if length > len(self.data) - self.at:
            raise ValueError(f"{length} bytes are said to follow, {len(self.data) - self.at} do")
        self.at += length
        return self.data[self.at - length : self.at]


def _align(out: bytearray, size: int) -> None:
    out.extend(bytes(-(len(out) - 4) % size))


@cache
def _putter(name: str) -> _Put:
    parts = [(field.name, _field_putter(field), _empty(field)) for field in fields_of(name)]

    def put_all(out: bytearray, values: Values) -> None:
        for key, put_one, empty in parts:
            put_one(out, values.get(key, empty))

    return put_all


def _empty(field: Field) -> Any:
    if field.many == "array":
        return ({} if "/" in field.kind else "" if field.kind == "string" else 0,) * field.length
    if field.many:
        return ()
    return {} if "/" in field.kind else "" if field.kind == "string" else 0


@cache
def _field_putter(field: Field) -> _Put:
    one = _one_putter(field)
    if not field.many:
        return one

    def put_many(out: bytearray, values: Any) -> None:
        _length(field, out, len(values))
        if field.kind in _BYTES:
            out.extend(bytes(values))
            return
        for value in values:
            one(out, value)

    return put_many


def _length(field: Field, out: bytearray, length: int) -> None:
    if (field.many == "array" and length != field.length) or (field.many == "bounded" and length > field.length):
        raise ValueError(f"{field.name} has {field.length} elements, not {length}")
    if field.many != "array":
        _align(out, 4)
        out.extend(struct.pack("<I", length))


def _one_putter(field: Field) -> _Put:
    if "/" in field.kind:
        return _putter(field.kind)
    if field.kind == "string":
        return _put_text
    coder = struct.Struct("<" + _CODES[field.kind])

    def put_number(out: bytearray, value: Any) -> None:
        _align(out, coder.size)
        out.extend(coder.pack(value))

    return put_number


def _put_text(out: bytearray, value: Any) -> None:
    raw = value.encode() + b"\0"
    _align(out, 4)
    out.extend(struct.pack("<I", len(raw)) + raw)


@cache
def _taker(name: str) -> _Take:
    parts = [(field.name, _field_taker(field)) for field in fields_of(name)]
    return lambda reader: {key: take(reader) for key, take in parts}


@cache
def _field_taker(field: Field) -> _Take:
    one = _one_taker(field)
    if not field.many:
        return one
    if field.kind in _BYTES:
        return lambda reader: reader.block(_count(field, reader))
    return lambda reader: [one(reader) for _ in range(_count(field, reader))]


def _count(field: Field, reader: Reader) -> int:
    if field.many == "array":
        return field.length
    count = int(reader.take("I", 4))
    if count > len(reader.data) - reader.at or count > _MOST:
        raise ValueError(f"{field.name} is said to have {count} elements")
    return count


def _one_taker(field: Field) -> _Take:
    if "/" in field.kind:
        return _taker(field.kind)
    if field.kind == "string":
        return lambda reader: bytes(reader.block(reader.take("I", 4))[:-1]).decode()
    code = _CODES[field.kind]
    size = struct.calcsize("<" + code)
    return lambda reader: reader.take(code, size)
