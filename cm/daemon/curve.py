# SPDX-License-Identifier: Apache-2.0
"""Who may connect over TCP: ZeroMQ's authentication protocol (ZMTP RFC 27, ZAP 1.0) for CURVE keys.

pyzmq's own authenticators need a thread or an asyncio loop of their own; this answers in ours.
"""

from __future__ import annotations

from collections.abc import Collection

import zmq
from zmq.utils import z85

_ADDRESS = "inproc://zeromq.zap.01"


class CurveAuthenticator:
    """Lets in the clients whose public keys are known. The loop's thread."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], clients: Collection[bytes]) -> None:
        self.socket = context.socket(zmq.REP)
        self.socket.linger = 0
        self.socket.bind(_ADDRESS)
        self._clients = frozenset(clients)

    def let_in(self, clients: Collection[bytes]) -> None:
        """Know these clients, and no others, from now on; connections that are there stay."""
        self._clients = frozenset(clients)

    def answer(self) -> None:
        """Answer one request, if there is one."""
        try:
            frames = self.socket.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return
        version, request, mechanism = frames[0], frames[1], frames[5]
        known = mechanism == b"CURVE" and len(frames) > 6 and z85.encode(frames[6]) in self._clients
        code, text = (b"200", b"OK") if known else (b"400", b"this key is not known here")
        self.socket.send_multipart([version, request, code, text, b"client" if known else b"", b""])

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
