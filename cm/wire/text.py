# SPDX-License-Identifier: Apache-2.0
"""The plain-text spellings of the paper's Listing 2.

``cm_config edge`` names a mode (or a module, or a configuration); ``cm_write_reg { 'focus':0x2}``
names registers and values as a Python or JSON mapping.
"""

from __future__ import annotations

import ast
import re

from cm.errors import InvalidRequest
from cm.messages.requests import ChangeMode, RegWrite, WriteReg

_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*(/[A-Za-z_][A-Za-z0-9_-]*)?")
_LIMIT = 65536


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


def parse_registers(payload: bytes) -> WriteReg:
    """``{ 'focus':0x2}`` → the writes in their order. Values are integers or true/false."""
    if len(payload) > _LIMIT:
        raise InvalidRequest(f"cm_write_reg: text of {len(payload)} bytes; at most {_LIMIT} are read")
    try:
        tree = ast.parse(payload.strip().decode("utf-8"), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InvalidRequest(f"cm_write_reg: {_shown(payload)} is not a mapping such as {{'focus': 0x2}}") from error
    if not isinstance(tree, ast.Dict) or not tree.keys:
        raise InvalidRequest(f"cm_write_reg: {_shown(payload)} is not a mapping such as {{'focus': 0x2}}")
    return WriteReg(tuple(_write(k, v) for k, v in zip(tree.keys, tree.values, strict=True)))


def _write(key: ast.expr | None, value: ast.expr) -> RegWrite:
    name = key.value if isinstance(key, ast.Constant) else None
    if not isinstance(name, str):
        raise InvalidRequest("cm_write_reg: register names are strings, as in {'focus': 0x2}")
    return RegWrite(name, _integer(name, value))


def _integer(name: str, node: ast.expr) -> int:
    if isinstance(node, ast.Constant) and isinstance(node.value, int):
        return int(node.value)
    if isinstance(node, ast.Name) and node.id in ("true", "false"):
        return int(node.id == "true")
    raise InvalidRequest(f"cm_write_reg: the value of {name!r} is no integer of 0 or more, such as 2 or 0x2")


def _shown(payload: bytes) -> str:
    text = payload[:40].decode("utf-8", "backslashreplace")
    return repr(text + ("…" if len(payload) > 40 else ""))
