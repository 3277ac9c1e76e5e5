# SPDX-License-Identifier: Apache-2.0
"""A client of simulated nodes with nothing but the protocol, independent of cm.device."""

from __future__ import annotations

import mmap
import os
import select
import socket
import struct
from pathlib import Path

import numpy as np

from cm.simulation.software.transport import protocol as p


class Node:
    """One open file of a node."""

    def __init__(self, root: Path, relative: str) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.sock.settimeout(60)
        fd = os.open(Path(root) / relative, os.O_PATH)
        try:
            self.sock.connect(f"/proc/self/fd/{fd}")
        finally:
            os.close(fd)
        self.events: socket.socket | None = None
        try:
            _, fds = self._reply()
        except OSError:
            self.sock.close()
            raise
        if fds:  # an attribute has no events
            self.events = socket.socket(fileno=fds[0])
            self.events.settimeout(60)

    def call(self, op: int, payload: bytes = b"", fds: tuple[int, ...] = ()) -> tuple[bytes, list[int]]:
        """Send a request and return its reply. Raises OSError with the errno of a refusal."""
        socket.send_fds(self.sock, [p.REQUEST.pack(op, len(payload)) + payload], list(fds))
        return self._reply()

    def _reply(self) -> tuple[bytes, list[int]]:
        data, fds, _, _ = socket.recv_fds(self.sock, 70000, 4)
        if not data:
            raise ConnectionResetError
        _, error, length, _ = p.REPLY.unpack_from(data)
        assert len(data) == p.REPLY.size + length
        if error:
            raise OSError(error, os.strerror(error))
        return data[p.REPLY.size :], fds

    def event(self, timeout: float = 60.0) -> bytes:
        """The next event packet."""
        self.events.settimeout(timeout)
        return self.events.recv(4096)

    def quiet(self, seconds: float = 0.15) -> bool:
        """Whether no event comes within this time."""
        return not select.select([self.events], [], [], seconds)[0]

    def close(self) -> None:
        self.sock.close()
        if self.events is not None:
            self.events.close()

    def __enter__(self) -> Node:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Uio(Node):
    def read(self, offset: int, width: int = 32) -> int:
        return p.REG.unpack(self.call(p.OP_REG_READ, p.REG.pack(0, width, offset, 0))[0])[3]

    def write(self, offset: int, value: int, width: int = 32) -> None:
        self.call(p.OP_REG_WRITE, p.REG.pack(0, width, offset, value))

    def unmask(self) -> None:
        self.events.send(struct.pack("<I", 1))

    def interrupt(self, timeout: float = 60.0) -> int:
        return struct.unpack("<I", self.event(timeout))[0]


class Buffered(Node):
    alloc_op = p.DMA_IOC_ALLOC
    free_op = p.DMA_IOC_FREE
    import_op = p.DMA_IOC_IMPORT

    def alloc(self, length: int) -> tuple[int, np.ndarray]:
        reply, fds = self.call(self.alloc_op, p.BUFFER_ALLOC.pack(p.BUFFER_ALLOC.size, 0, length, 0, -1, 0, 0, 0))
        fields = p.BUFFER_ALLOC.unpack(reply)
        memory = np.frombuffer(mmap.mmap(fds[0], fields[2]), np.uint8)
        os.close(fds[0])
        return fields[3], memory

    def attach(self, fd: int) -> tuple[int, int]:
        reply, _ = self.call(self.import_op, p.BUFFER_IMPORT.pack(p.BUFFER_IMPORT.size, 0, -1, 0, 0), (fd,))
        fields = p.BUFFER_IMPORT.unpack(reply)
        return fields[3], fields[4]

    def free(self, handle: int) -> None:
        self.call(self.free_op, p.BUFFER_FREE.pack(p.BUFFER_FREE.size, 0, handle, 0))


class Dma(Buffered):
    def submit(self, handle: int, length: int, offset: int = 0, cookie: int = 0, period: int = 0) -> None:
        flags = p.SUBMIT_CYCLIC if period else 0
        self.call(
            p.DMA_IOC_SUBMIT, p.DMA_SUBMIT.pack(p.DMA_SUBMIT.size, flags, handle, 0, offset, length, period, cookie)
        )

    def submit_video(self, handle: int, lines: int, line_bytes: int, stride: int, cookie: int = 0) -> None:
        size = p.DMA_SUBMIT_VIDEO.size
        self.call(
            p.DMA_IOC_SUBMIT_VIDEO, p.DMA_SUBMIT_VIDEO.pack(size, 0, handle, lines, 0, line_bytes, stride, cookie)
        )

    def cancel(self) -> None:
        self.call(p.DMA_IOC_CANCEL, p.DMA_CANCEL.pack(p.DMA_CANCEL.size, 0))

    def done(self, timeout: float = 60.0) -> tuple[int, ...]:
        """cookie, length, timestamp_ns, sequence, status, flags"""
        return p.DMA_COMPLETION.unpack(self.event(timeout))


class Icap(Buffered):
    alloc_op = p.ICAP_IOC_ALLOC
    free_op = p.ICAP_IOC_FREE
    import_op = p.ICAP_IOC_IMPORT

    def load(self, data: bytes, cookie: int = 0, flags: int = 0) -> tuple[int, int]:
        """Load words in memory order and wait; status and error bits."""
        self.start(data, cookie, flags)
        return self.finished()

    def start(self, data: bytes, cookie: int = 0, flags: int = 0) -> None:
        handle, memory = self.alloc(max(1, len(data)))
        memory[: len(data)] = np.frombuffer(data, np.uint8)
        fields = (p.ICAP_LOAD.size, flags, handle, 0, 0, len(data), cookie)
        self.call(p.ICAP_IOC_LOAD, p.ICAP_LOAD.pack(*fields))

    def finished(self, timeout: float = 60.0) -> tuple[int, int]:
        fields = p.ICAP_COMPLETION.unpack(self.event(timeout))
        return fields[4], fields[5]

    def status(self) -> tuple[int, ...]:
        """state, errors, bytes_done, bytes_total, loads"""
        reply, _ = self.call(p.ICAP_IOC_STATUS, p.ICAP_STATUS.pack(p.ICAP_STATUS.size, 0, 0, 0, 0, 0, 0))
        return p.ICAP_STATUS.unpack(reply)[2:]


def attribute(root: Path, relative: str, data: bytes | None = None) -> bytes:
    """Read an attribute's socket, or write it."""
    with Node(root, relative) as node:
        return node.call(p.OP_ATTR_READ if data is None else p.OP_ATTR_WRITE, data or b"")[0]
