# SPDX-License-Identifier: Apache-2.0
"""Attributes of sysfs and configfs as nodes: files for which the simulator must notice that they are written."""

from __future__ import annotations

import errno
from collections.abc import Callable, Sequence

from cm.simulation.software.errors import NodeError
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.session import Attribute, Later

Read = Callable[[], bytes]
Write = Callable[[bytes], "Later | None"]
Name = Callable[[str], None]


class AttributeNode(Attribute):
    """One attribute; what cannot be read or written is refused with EACCES."""

    def __init__(self, read: Read | None = None, write: Write | None = None) -> None:
        self._read, self._write = read, write

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Later:  # noqa: ARG002
        """Read or write it as a whole."""
        if op == protocol.OP_ATTR_READ and self._read is not None:
            return self._read()
        if op == protocol.OP_ATTR_WRITE and self._write is not None:
            return self._write(payload) or b""
        raise NodeError(errno.EACCES if op in (protocol.OP_ATTR_READ, protocol.OP_ATTR_WRITE) else errno.ENOTTY)


class FolderNode(Attribute):
    """The ``.node`` of a configfs folder: mkdir and rmdir in it."""

    def __init__(self, mkdir: Name, rmdir: Name) -> None:
        self._calls = {protocol.OP_MKDIR: mkdir, protocol.OP_RMDIR: rmdir}

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes:  # noqa: ARG002
        """Make or remove a folder."""
        call = self._calls.get(op)
        if call is None:
            raise NodeError(errno.ENOTTY, "a folder takes mkdir and rmdir")
        try:
            name = payload.decode("utf-8")
        except UnicodeDecodeError:
            raise NodeError(errno.EINVAL, "the name is not UTF-8") from None
        if not name or len(payload) > 255 or name.startswith(".") or "/" in name or not name.isprintable():
            raise NodeError(errno.EINVAL, "not a name for a folder")
        call(name)
        return b""
