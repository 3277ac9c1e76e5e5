# SPDX-License-Identifier: Apache-2.0
"""Messages to and from the engine: engine/messages.h in Python."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

_HEAD = struct.Struct("=IIQQQQ")
TEXT = 4096
ANSWER = 128
ARENA_BYTES = 1 << 32
EXCHANGE = 32 << 20  # the place in the arena where bytes of memory are exchanged


class Op(IntEnum):
    """What a message is about; requests up to `COVER`, then events."""

    READ = 1
    WRITE = 2
    SEND = 3
    RECEIVE = 4
    CANCEL = 5
    LOAD = 6
    UNDEFINE = 7
    EMPTY = 8
    CONFIGURE = 9
    RESET = 10
    TRACE = 11
    MARK = 12
    STATE = 13
    COVER = 14
    SENT = 64
    RECEIVED = 65
    INTERRUPT = 66
    OUTPUT = 67
    STOPPED = 68
    FETCH = 72
    STORE = 73


@dataclass(frozen=True, slots=True)
class Message:
    """Four numbers and a text, by the meaning of `op` (engine/messages.h)."""

    op: int
    id: int = 0
    a: int = 0
    b: int = 0
    c: int = 0
    d: int = 0
    text: str = ""

    def pack(self) -> bytes:
        """As it travels."""
        return _HEAD.pack(self.op, self.id, self.a, self.b, self.c, self.d) + self.text.encode()[:TEXT]

    @classmethod
    def unpack(cls, data: bytes) -> Message:
        """From what came."""
        op, number, a, b, c, d = _HEAD.unpack_from(data)
        return cls(op, number, a, b, c, d, data[_HEAD.size :].decode(errors="replace"))
