# SPDX-License-Identifier: Apache-2.0
"""pyzmq REQ/REP over ipc, each message copied as pyzmq does by default."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import zmq

_ADDRESS = "address"  # file in the folder, of the far end


class ZmqNear:
    """A REQ socket that sends `size` bytes and takes them back."""

    def __init__(self, address: str, size: int) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.REQ)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.connect(address)
        self._payload = b"\x5a" * size

    def trip(self) -> bytes:
        """There and back."""
        self._socket.send(self._payload)
        return self._socket.recv()

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()
        self._context.term()


def near(folder: Path, size: int) -> ZmqNear:
    """This end."""
    return ZmqNear((folder / _ADDRESS).read_text(encoding="utf-8"), size)


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (any size)
    """The other end."""
    echo(f"ipc://{folder}/zmq", folder, ready)


def echo(address: str, folder: Path, ready: Callable[[], None]) -> None:
    """Send back whatever comes."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.REP)
    socket.bind(address)
    (folder / _ADDRESS).write_bytes(socket.last_endpoint)
    ready()
    while True:
        socket.send(socket.recv())
