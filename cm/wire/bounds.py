# SPDX-License-Identifier: Apache-2.0
"""Bounds of one request, listed in docs/limits.md; a request within them costs the manager milliseconds at most."""

from __future__ import annotations

from collections.abc import Generator
from typing import ClassVar, TypeVar

from google.protobuf.message import Message

from cm.errors import InvalidRequest

ENTRIES = 1024  # of anything that is listed: registers, extents of a shape
FILES = 256  # of a configuration
NAME_BYTES = 256
LEASES_BYTES = 4096  # ids between commas
SCHEMA_BYTES = 1 << 20
MESSAGE_BYTES = 128 << 10  # of the second frame, unless it holds a schema
WAIT_SECONDS = 86_400.0  # that a request waits for a frame; longer ones, and infinity, are taken as this
SLICE = 64  # listed things that one turn of the manager's loop reads
_ALWAYS_FINE = 256  # bytes of a message that is too short to break any bound
_LIMITS = {"schema": SCHEMA_BYTES, "lease": LEASES_BYTES}
_T = TypeVar("_T")


class TooMany(InvalidRequest):
    """A request lists more entries than are allowed."""

    code: ClassVar[str] = "too_many"


class TooLong(InvalidRequest):
    """A message or a text is longer than allowed."""

    code: ClassVar[str] = "too_long"


class NameTooLong(InvalidRequest):
    """A name is longer than any name can be."""

    code: ClassVar[str] = "name_too_long"


def check_length(topic: str, message: bytes, schema: bool = False) -> None:
    """Raise TooLong for a message that is too long to be parsed: that takes time in proportion to its length."""
    most = SCHEMA_BYTES + MESSAGE_BYTES if schema else MESSAGE_BYTES
    if len(message) > most:
        raise TooLong(f"{topic}: a message of {len(message)} bytes; {most} at most, and data in frames behind it")


def check(topic: str, message: Message, size: int) -> None:
    """Raise TooMany, NameTooLong for what is in a message of `size` bytes."""
    if size > _ALWAYS_FINE:
        _check(topic, message)


def _check(topic: str, message: Message) -> None:
    for field, value in message.ListFields():
        one = isinstance(value, (str, int, float, Message))
        if not one:
            check_count(topic, field.name, len(value), FILES if field.name == "files" else ENTRIES)
        for part in (value,) if one else value:
            if isinstance(part, str):
                check_text(topic, field.name, part)
            elif isinstance(part, Message):
                _check(topic, part)


def check_count(topic: str, what: str, count: int, most: int = ENTRIES) -> None:
    """Raise TooMany."""
    if count > most:
        raise TooMany(f"{topic}: {count} {what}; one request has {most} at most: send several")


def check_text(topic: str, field: str, text: str) -> None:
    """Raise NameTooLong."""
    most = _LIMITS.get(field, NAME_BYTES)
    if len(text.encode()) > most:
        raise NameTooLong(f"{topic}: {field} has {len(text.encode())} bytes ({text[:32]!r}…); {most} at most")


def in_one_go(slices: Generator[None, None, _T]) -> _T:
    """What comes of reading a request in slices."""
    while True:
        try:
            next(slices)
        except StopIteration as ended:
            result: _T = ended.value
            return result
