# SPDX-License-Identifier: Apache-2.0
"""The node that lends register pages (``cm_window.h``). A grant is a connection, and a page with its state."""

from __future__ import annotations

import errno
import mmap
import os
from collections.abc import Sequence

from cm.simulation.software.errors import NodeError
from cm.simulation.software.hardware.fabric import Fabric
from cm.simulation.software.hardware.logic import Accesses
from cm.simulation.software.hardware.register_windows import Window, shared_to_read
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.buffers import fit
from cm.simulation.software.transport.server import Server
from cm.simulation.software.transport.session import Answer, Events, Ioctls, Opened, Session

PAGE = mmap.PAGESIZE
MOST = 4096  # grants of one file


class WindowNode:
    """``/dev/cm_window``; any number of files may be open."""

    def __init__(self, fabric: Fabric, bus: Accesses, server: Server) -> None:
        self.fabric, self.bus, self.server = fabric, bus, server
        self.grants: set[_Grant] = set()  # of all files, those revoked too

    def open(self, events: Events) -> WindowSession:
        """A new open file."""
        return WindowSession(self, events)

    def window(self, address: int, length: int) -> Window:
        """The window that has these pages, and nothing else's. Raises NodeError as the kernel does."""
        found = [window for window in self.fabric.windows if _has(window, address, length)]
        if not found:
            raise NodeError(errno.ENXIO, "no window has the whole range")
        if self._shared(address, length):
            raise NodeError(errno.EPERM, "others have registers in these pages")
        return found[0]

    def _shared(self, address: int, length: int) -> bool:
        """Whether a region is isolated by a register in these pages."""
        parts = [region.spec.decoupler for region in self.fabric.regions.values()]
        places = [part.base_address + part.offset for part in parts if part is not None and part.size]
        return any(address <= place < address + length for place in places)


def _has(window: Window, address: int, length: int) -> bool:
    start = window.spec.address
    return bool(window.spec.size) and start <= address and address + length <= start + window.spec.size


class WindowSession(Ioctls):
    """One open file: what it has lent."""

    def __init__(self, node: WindowNode, events: Events) -> None:
        self.bus, self._node, self._events = node.bus, node, events
        self._grants: dict[int, _Grant] = {}
        self._last = 0
        super().__init__({protocol.WINDOW_IOC_GRANT: self._grant, protocol.WINDOW_IOC_REVOKE: self._revoke})

    def _grant(self, payload: bytes) -> Answer:
        flags, address, length, _, _ = protocol.unpack(protocol.WINDOW_GRANT, payload)
        if flags & ~protocol.WINDOW_WRITE or not length or address % PAGE or length % PAGE:
            raise NodeError(errno.EINVAL, "whole pages are lent")
        window = self._node.window(address, length)
        if len(self._grants) >= MOST:
            raise NodeError(errno.ENOSPC, "too many grants")
        self._last += 1
        grant = _Grant(self, window, (self._last, flags, address, length))
        connection = self._node.server.connect(grant)
        self._grants[grant.id] = grant
        self._node.grants.add(grant)
        answer = protocol.WINDOW_GRANT.pack(len(payload), flags, address, length, grant.id, -1)
        return Answer(fit(answer, payload), [connection.detach()])

    def _revoke(self, payload: bytes) -> bytes:
        flags, address, length, number, _ = protocol.unpack(protocol.WINDOW_REVOKE, payload)
        if flags or (number and (address or length)) or not (number or length):
            raise NodeError(errno.EINVAL, "a grant, or a range")
        if number:
            if number not in self._grants:
                raise NodeError(errno.ENOENT, "no such grant of this file")
            taken = [self._grants[number]]
        else:
            taken = [grant for grant in self._node.grants if grant.touches(address, length)]
        count = sum(grant.revoke(protocol.WINDOW_REVOKED_CALL) for grant in taken)
        return fit(protocol.WINDOW_REVOKE.pack(len(payload), flags, address, length, number, count), payload)

    def released(self, grant: _Grant) -> None:
        """Nobody has it any more."""
        self._node.grants.discard(grant)
        if self._grants.pop(grant.id, None) is not None:
            self._events.send(protocol.WINDOW_EVENT.pack(grant.id, protocol.WINDOW_RELEASED))

    def close(self) -> None:
        """Who lent is gone."""
        grants, self._grants = list(self._grants.values()), {}
        for grant in grants:
            grant.revoke(protocol.WINDOW_REVOKED_OWNER)


class _Grant:
    """The node behind a grant's descriptor, which is open from the start, once; and its state."""

    def __init__(self, session: WindowSession, window: Window, what: tuple[int, int, int, int]) -> None:
        self.session, self.window = session, window
        self.id, self.flags, self.address, self.length = what
        self.revoked = 0
        self.offset = self.address - window.spec.address
        self._fd, self._state = shared_to_read("cm-grant", PAGE)
        self._tell()

    def open(self, events: Events) -> Opened:  # noqa: ARG002 (there are none)
        return Opened(_GrantSession(self), protocol.OFFERS_MIRROR)

    def touches(self, address: int, length: int) -> bool:
        """Whether a range has some of it."""
        return self.address < address + length and address < self.address + self.length

    def revoke(self, reason: int) -> bool:
        """Take it back; False where it had been."""
        if self.revoked:
            return False
        self.revoked = reason
        self._tell()
        return True

    def descriptor(self) -> int:
        """Of its state, the caller's."""
        return os.dup(self._fd)

    def _tell(self) -> None:
        protocol.WINDOW_STATE.pack_into(self._state, 0, self.revoked, self.flags, self.length)

    def __del__(self) -> None:
        os.close(self._fd)


class _GrantSession(Session):
    """Accesses of who has the grant, counted from its first byte."""

    def __init__(self, grant: _Grant) -> None:
        self._grant = grant

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Answer:  # noqa: ARG002 (none is taken)
        """Answer a register access, or hand out state and mirror."""
        grant = self._grant
        if op == protocol.OP_GRANT:
            return Answer(protocol.NODE_GRANT.pack(-1, 0, grant.offset), [grant.descriptor()])
        if op == protocol.OP_MIRROR:
            mirror = grant.window.mirror
            return Answer(protocol.MIRROR.pack(0, -1, mirror.size), [mirror.descriptor()])
        if op not in (protocol.OP_REG_READ, protocol.OP_REG_WRITE):
            raise NodeError(errno.ENOTTY, "a grant has register accesses only")
        return self._access(op, payload)

    def _access(self, op: int, payload: bytes) -> bytes:
        grant = self._grant
        if len(payload) != protocol.REG.size:
            raise NodeError(errno.EINVAL, "a register access is a struct cm_node_reg")
        number, width, offset, value = protocol.REG.unpack(payload)
        if number or offset + width // 8 > grant.length:
            raise NodeError(errno.EINVAL, "behind the grant's end")
        if grant.revoked:
            raise NodeError(errno.ESTALE, "it was taken back")
        if op == protocol.OP_REG_READ:
            value = grant.session.bus.read(grant.window, grant.offset + offset, width)
        elif not grant.flags & protocol.WINDOW_WRITE:
            raise NodeError(errno.EACCES, "it is for reading")
        else:
            grant.session.bus.write(grant.window, grant.offset + offset, width, value)
        return protocol.REG.pack(number, width, offset, value)

    def close(self) -> None:
        """Its last descriptor is gone."""
        self._grant.session.released(self._grant)
