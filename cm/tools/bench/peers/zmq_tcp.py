# SPDX-License-Identifier: Apache-2.0
"""pyzmq REQ/REP over the loopback's TCP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import zmq

from cm.tools.bench.peers.zmq_echo import ZmqNear

_ADDRESS = "tcp-address"  # file in the folder that names the port


def near(folder: Path, size: int) -> ZmqNear:
    """This end."""
    return ZmqNear((folder / _ADDRESS).read_text(encoding="ascii"), size)


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (any size)
    """The other end, at a free port."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.REP)
    port = socket.bind_to_random_port("tcp://127.0.0.1")
    (folder / _ADDRESS).write_text(f"tcp://127.0.0.1:{port}", encoding="ascii")
    ready()
    while True:
        socket.send(socket.recv())
