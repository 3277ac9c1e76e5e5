# SPDX-License-Identifier: Apache-2.0
"""What rmw_zenoh attaches to every message, request and reply: its number, when it was sent, and who sent it."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from cm.errors import InvalidRequest

_LAYOUT = struct.Struct("<qqB16s")  # as zenoh's serializer writes two integers and an array with its length before it
_GID = 16


@dataclass(frozen=True, slots=True)
class Attachment:
    """`number` counts from 1 for each sender; `stamp_ns` is wall time; `gid` are its sender's 16 bytes."""

    number: int
    stamp_ns: int
    gid: bytes

    def to_bytes(self) -> bytes:
        """As it lies on the wire."""
        return _LAYOUT.pack(self.number, self.stamp_ns, _GID, self.gid)

    @classmethod
    def from_bytes(cls, data: bytes) -> Attachment:
        """Raises InvalidRequest for what is no attachment."""
        if len(data) != _LAYOUT.size or data[16] != _GID:
            raise InvalidRequest(
                f"this is not an attachment of rmw_zenoh since Jazzy: {data[:40].hex(' ') or 'nothing'}"
            )
        number, stamp_ns, _, gid = _LAYOUT.unpack(data)
        return cls(number, stamp_ns, gid)
