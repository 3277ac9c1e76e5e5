# SPDX-License-Identifier: Apache-2.0
"""Keys of a fleet, ``cm/<board>/{alive,status,config,reg/*,irq/*,frames/*,do/<verb>[/<caller>]}``, and commands."""

from __future__ import annotations

from dataclasses import dataclass

from cm.errors import InvalidRequest
from cm.wire import topics

ROOT = "cm"
BUNDLES = "cm-bundles"
STORE = "cm-store"
WILD = frozenset("*$?#")
AGAIN = "again"  # in place of a change's id: a person asks a board to go where it is wanted
NOBODY = "nobody"  # a caller that gives no name


def check(name: str, what: str) -> str:
    """The name, if it can be a part of a key. Raises InvalidRequest."""
    if not name or name.startswith("@") or not name.isprintable() or len(name.encode()) > 64:
        raise InvalidRequest(f"{what} {name!r}: 1 to 64 printable characters are wanted, the first of them no @")
    bad = sorted((WILD | {"/", " "}) & set(name))
    if bad:
        shown = " ".join("a space" if character == " " else character for character in bad)
        raise InvalidRequest(f"{what} {name!r} must not have {shown} in it: it is a part of a key")
    return name


def key(board: str, *parts: str) -> str:
    """The key of something of a board."""
    return "/".join((ROOT, board, *parts))


def board_of(key_expression: str) -> str:
    """The board in a key."""
    return key_expression.split("/")[1]


def command(verb: str, caller: str) -> str:
    """The part of a key behind the board, of a command in a caller's name."""
    return f"do/{verb}/{caller}" if caller else f"do/{verb}"


def command_of(key_expression: str) -> tuple[str, str] | None:
    """The verb and the caller in a query's key; None if it has none. They have no wildcards."""
    parts = key_expression.split("/")
    if len(parts) not in (4, 5) or parts[0] != ROOT or parts[2] != "do" or any(WILD & set(p) for p in parts[3:]):
        return None
    return parts[3], parts[4] if len(parts) == 5 else ""


@dataclass(frozen=True, slots=True)
class Verb:
    """A command: the role that it needs, and its topic at the manager; without one the bridge carries it out itself."""

    role: str
    topic: bytes = b""


VERBS = {
    "mode": Verb("operate", topics.WRITE_CONFIG),
    "reg": Verb("operate", topics.WRITE_REG),
    "stream": Verb("operate", topics.DATA_CONFIG),
    "data": Verb("operate", topics.WRITE_DATA),
    "lease": Verb("operate", topics.LEASE),
    "upload": Verb("operate", topics.UPLOAD),
    "provision": Verb("provision", topics.WRITE_CONFIG),
    "prepare": Verb("operate"),
    "apply": Verb("operate"),
    "reconcile": Verb("operate"),
    "bundle": Verb("provision"),
}
