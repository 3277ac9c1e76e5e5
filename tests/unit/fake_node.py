# SPDX-License-Identifier: Apache-2.0
"""Simulated nodes for the device tests: servers that behave well or badly, packet by packet.

Written independently from kmod/uapi/cm_node.h, so that it shares no mistake with `cm.simulation.software`.
"""

from __future__ import annotations

import array
import contextlib
import os
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

REQUEST = struct.Struct("=II")
REPLY = struct.Struct("=IiII")
REG = struct.Struct("=IIQQ")
OPEN, REG_READ, REG_WRITE, ATTR_READ, ATTR_WRITE, MKDIR, RMDIR = range(7)

# A handler gets (op, payload, descriptors, event socket) and returns (errno, payload, descriptors).
Reply = tuple[int, bytes, list[int]]
Handler = Callable[[int, bytes, list[int], socket.socket], Reply]


class FakeNode:
    """Serves one node at ``root/path``, each connection in a thread, until it is closed."""

    def __init__(self, root: Path, path: str, handler: Handler, open_error: int = 0) -> None:
        self._handler = handler
        self._open_error = open_error
        self._threads: list[threading.Thread] = []
        self._connections: list[socket.socket] = []
        self.written: list[bytes] = []
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        folder = os.open((root / path).parent, os.O_PATH)
        try:
            self._listener.bind(f"/proc/self/fd/{folder}/{Path(path).name}")
        finally:
            os.close(folder)
        self._listener.listen()
        self._spawn(self._accept)

    def close(self) -> None:
        """Stop serving; connections end as they do when the simulator is killed."""
        for sock in [self._listener, *self._connections]:
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(60)
        self._listener.close()

    def __enter__(self) -> FakeNode:
        return self

    def __exit__(self, kind: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _spawn(self, target: Callable[..., None], *args: object) -> None:
        thread = threading.Thread(target=target, args=args, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                sock, _ = self._listener.accept()
                self._connections.append(sock)
                self._spawn(self._serve, sock)

    def _serve(self, sock: socket.socket) -> None:
        events, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with sock, events:
            with theirs, contextlib.suppress(OSError):
                socket.send_fds(sock, [REPLY.pack(OPEN, self._open_error, 0, 0)], [theirs.fileno()])
            self._spawn(self._drain, events.dup())
            with contextlib.suppress(OSError, EOFError):
                while not self._open_error:
                    self._answer(sock, events)
            with contextlib.suppress(OSError):
                events.shutdown(socket.SHUT_RDWR)

    def _answer(self, sock: socket.socket, events: socket.socket) -> None:
        data, ancillary, _, _ = sock.recvmsg(1 << 17, socket.CMSG_SPACE(16))
        if not data:
            raise EOFError
        op, length = REQUEST.unpack_from(data)
        assert length == len(data) - REQUEST.size
        fds = array.array("i")
        for _, _, part in ancillary:
            fds.frombytes(part)
        try:
            error, payload, out = self._handler(op, data[REQUEST.size :], list(fds), events)
        finally:
            for fd in fds:
                os.close(fd)
        socket.send_fds(sock, [REPLY.pack(op, error, len(payload), 0) + payload], out)
        for fd in out:
            os.close(fd)

    def _drain(self, events: socket.socket) -> None:
        with events, contextlib.suppress(OSError):
            while data := events.recv(64):
                self.written.append(data)


def attribute(root: Path, path: str, text: str) -> None:
    """Write a plain file under ``root``."""
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


def uio_class(root: Path, number: int, name: str, maps: list[tuple[int, int]]) -> None:
    """Write the sysfs files of a UIO device with (address, size) maps."""
    folder = f"sys/class/uio/uio{number}"
    attribute(root, f"{folder}/name", f"{name}\n")
    for index, (address, size) in enumerate(maps):
        attribute(root, f"{folder}/maps/map{index}/addr", f"0x{address:x}\n")
        attribute(root, f"{folder}/maps/map{index}/size", f"0x{size:x}\n")
        attribute(root, f"{folder}/maps/map{index}/offset", "0x0\n")
        attribute(root, f"{folder}/maps/map{index}/name", f"window{index}\n")
