# SPDX-License-Identifier: Apache-2.0
"""The plain-text spellings of the paper's Listing 2.

``cm_config edge`` names a mode (or a module, or a configuration); ``cm_write_reg { 'focus':0x2}``
names registers and values as a Python or JSON mapping.
"""

from __future__ import annotations

import re
from collections.abc import Generator

from cm.errors import InvalidRequest
from cm.wire import bounds
from cm.wire.messages.requests import ChangeMode, RegWrite, WriteReg

_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*(/[A-Za-z_][A-Za-z0-9_-]*)?")
_STRING = r"""'[^'\\\n]*'|"[^"\\\n]*\""""
_BLANKS = re.compile(r"\s*")
_ENTRY = re.compile(rf"({_STRING})\s*:\s*([A-Za-z0-9_]+)\s*(?:,|(?=\}}))")
_KEY = re.compile(rf"({_STRING}|\w+)\s*:")


def is_word(payload: bytes) -> bool:
    """Whether a payload is a name in plain text rather than a protobuf message.

    No message that a protobuf library encodes looks like this: its keys and lengths are control
    characters.
    """
    text = payload.strip()
    return len(text) <= 256 and text.isascii() and _WORD.fullmatch(text.decode("ascii")) is not None


def is_mapping(payload: bytes) -> bool:
    """Whether a payload is a mapping in plain text; ``{`` never begins a message of ours."""
    return payload.lstrip()[:1] == b"{"


def parse_config(payload: bytes) -> ChangeMode:
    """``edge`` or ``camera/edge_detection`` → the request to go there, without waiting."""
    if not is_word(payload):
        raise InvalidRequest(
            f"cm_config takes the name of a mode, a module or CONFIG/MODE as plain text, not {_shown(payload)}"
        )
    word = payload.strip().decode("ascii")
    config, slash, mode = word.partition("/")
    if slash:
        return ChangeMode(config_name=config, mode=mode)
    return ChangeMode(name_or_mode=word)


def in_slices(payload: bytes) -> Generator[None, None, WriteReg]:
    """``{ 'focus':0x2}`` → the writes in their order, some with each `next`. Values are integers or true/false.

    Raises InvalidRequest; TooLong, TooMany and NameTooLong for what no request may hold. Takes a time proportional to
    the length of the text.
    """
    bounds.check_length("cm_write_reg", payload)
    try:
        text = payload.strip().decode("utf-8")
    except UnicodeDecodeError:
        raise _no_mapping(payload) from None
    if not text.startswith("{"):
        raise _no_mapping(payload)
    writes: list[RegWrite] = []
    at = _after_blanks(text, 1)
    while not text.startswith("}", at):
        entry = _ENTRY.match(text, at)
        if entry is None:
            yield  # to find that out may have taken a while, as it does to find out what is wrong
            raise _wrong_entry(payload, text, at)
        writes.append(_write(entry[1], entry[2]))
        bounds.check_count("cm_write_reg", "writes", len(writes))
        if len(writes) % bounds.SLICE == 0:
            yield
        at = _after_blanks(text, entry.end())
    if at + 1 != len(text) or not writes:
        raise _no_mapping(payload)
    return WriteReg(tuple(writes))


def _after_blanks(text: str, at: int) -> int:
    blanks = _BLANKS.match(text, at)
    return blanks.end() if blanks else at


def _write(quoted: str, value: str) -> RegWrite:
    name = quoted[1:-1]
    if len(name.encode()) > bounds.NAME_BYTES:
        raise bounds.NameTooLong(f"cm_write_reg: a name of {len(name.encode())} bytes; {bounds.NAME_BYTES} at most")
    if value in ("true", "True", "false", "False"):
        return RegWrite(name, int(value in ("true", "True")))
    base = {"0x": 16, "0o": 8, "0b": 2}.get(value[:2].lower(), 10)
    try:
        number = int(value, base)
    except ValueError:
        raise _no_integer(name) from None
    if number >> 64:
        raise _no_integer(name)
    return RegWrite(name, number)


def _wrong_entry(payload: bytes, text: str, at: int) -> InvalidRequest:
    """What is wrong where an entry should be."""
    key = _KEY.match(text, at)
    if key is None:
        return _no_mapping(payload)
    if key[1][0] not in "'\"":
        return InvalidRequest("cm_write_reg: register names are strings, as in {'focus': 0x2}")
    return _no_integer(key[1][1:-1][: bounds.NAME_BYTES])


def _no_integer(name: str) -> InvalidRequest:
    return InvalidRequest(
        f"cm_write_reg: the value of {name!r} is not an integer from 0 to 2**64 - 1, such as 2 or 0x2"
    )


def _no_mapping(payload: bytes) -> InvalidRequest:
    return InvalidRequest(f"cm_write_reg: {_shown(payload)} is not a mapping such as {{'focus': 0x2}}")


def _shown(payload: bytes) -> str:
    text = payload[:40].decode("utf-8", "backslashreplace")
    return repr(text + ("…" if len(payload) > 40 else ""))
