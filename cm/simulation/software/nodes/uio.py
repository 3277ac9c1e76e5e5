# SPDX-License-Identifier: Apache-2.0
"""UIO devices as nodes."""

from __future__ import annotations

import errno
from collections.abc import Sequence

from cm.simulation.software.errors import NodeError
from cm.simulation.software.hardware.interrupts import Line
from cm.simulation.software.hardware.logic import Accesses
from cm.simulation.software.hardware.register_windows import Window
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.root import Root
from cm.simulation.software.transport.session import Answer, Events, Opened, Session


class UioNode:
    """``/dev/uioN``; any number of files may be open."""

    def __init__(self, window: Window, line: Line, bus: Accesses) -> None:
        self._window, self._line, self._bus = window, line, bus

    def open(self, events: Events) -> Opened:
        """A new open file."""
        session = UioSession(self._window, self._line, self._bus, events)
        return Opened(session, protocol.OFFERS_MIRROR | protocol.OFFERS_BLOCKS if self._window.spec.size else 0)


class UioSession(Session):
    """One open file: register accesses, and the interrupt through the event socket."""

    def __init__(self, window: Window, line: Line, bus: Accesses, events: Events) -> None:
        self._window, self._line, self._bus, self._events = window, line, bus, events
        line.listen(events)

    def request(self, op: int, payload: bytes, fds: Sequence[int]) -> bytes | Answer:  # noqa: ARG002 - none is taken
        """Answer a register access, or hand out the window's mirror."""
        if op == protocol.OP_MIRROR:
            return self._mirror(payload)
        if op in (protocol.OP_BLOCK_READ, protocol.OP_BLOCK_WRITE):
            return self._block(op, payload)
        if op not in (protocol.OP_REG_READ, protocol.OP_REG_WRITE):
            raise NodeError(errno.ENOTTY, "a UIO device has register accesses only")
        if len(payload) != protocol.REG.size:
            raise NodeError(errno.EINVAL, "a register access is a struct cm_node_reg")
        number, width, offset, value = protocol.REG.unpack(payload)
        if number != 0 or not self._window.spec.size:
            raise NodeError(errno.EINVAL, "there is no such map")
        if op == protocol.OP_REG_READ:
            value = self._bus.read(self._window, offset, width)
        else:
            self._bus.write(self._window, offset, width, value)
        return protocol.REG.pack(number, width, offset, value)

    def _block(self, op: int, payload: bytes) -> bytes:
        head = protocol.BLOCK.size
        if len(payload) < head or (op == protocol.OP_BLOCK_READ and len(payload) != head):
            raise NodeError(errno.EINVAL, "a block is a struct cm_node_block, and bytes only if they are written")
        number, length, offset = protocol.BLOCK.unpack_from(payload)
        if number != 0 or not self._window.spec.size:
            raise NodeError(errno.EINVAL, "there is no such map")
        if op == protocol.OP_BLOCK_READ:
            return self._bus.read_block(self._window, offset, length)
        if len(payload) != head + length:
            raise NodeError(errno.EINVAL, "a block has the bytes that it says")
        self._bus.write_block(self._window, offset, payload[head:])
        return b""

    def _mirror(self, payload: bytes) -> Answer:
        if len(payload) != protocol.MIRROR.size:
            raise NodeError(errno.EINVAL, "a mirror is asked for by a struct cm_node_mirror")
        if protocol.MIRROR.unpack(payload)[0] != 0 or not self._window.spec.size:
            raise NodeError(errno.EINVAL, "there is no such map")
        mirror = self._window.mirror
        return Answer(protocol.MIRROR.pack(0, -1, mirror.size), [mirror.descriptor()])

    def write(self, data: bytes) -> None:
        """Unmask (u32 1) or mask (0) the interrupt."""
        if len(data) != 4:
            raise NodeError(errno.EINVAL, "a UIO device takes 4 bytes")
        self._line.control(int.from_bytes(data, "little"))

    def close(self) -> None:
        """The file was closed."""
        self._line.forget(self._events)


def write_sysfs(root: Root, index: int, window: Window) -> None:
    """The device's folder under /sys/class/uio."""
    base = f"sys/class/uio/uio{index}"
    spec = window.spec
    root.write(f"{base}/name", spec.name + "\n")
    root.write(f"{base}/version", "sim\n")
    root.write(f"{base}/event", "0\n")
    if spec.size:
        for name, text in (
            ("addr", hex(spec.address)),
            ("size", hex(spec.size)),
            ("offset", "0x0"),
            ("name", spec.name),
        ):
            root.write(f"{base}/maps/map0/{name}", text + "\n")
