# SPDX-License-Identifier: Apache-2.0
"""ZeroMQ's authentication protocol (ZMTP RFC 27, ZAP 1.0), answered where the sockets are served.

pyzmq's own authenticators need a thread or an asyncio loop of their own, and know no peers over ipc.
"""

from __future__ import annotations

from collections.abc import Callable

import zmq
from zmq.utils import z85

_ADDRESS = "inproc://zeromq.zap.01"


class Authenticator:
    """Asks `admit` about each connection: the user id of its messages, or None to refuse it. One thread.

    `admit` is given what libzmq knows: the socket's domain; the peer's address, over TCP its IP, over ipc
    ``…:UID:GID:PID`` as the kernel has it; the mechanism; and with CURVE the public key (Z85).
    """

    def __init__(
        self, context: zmq.Context[zmq.Socket[bytes]], admit: Callable[[str, str, str, str], str | None]
    ) -> None:
        """To be made before the first bind: libzmq admits every peer as long as nothing answers."""
        self.socket = context.socket(zmq.REP)
        self.socket.linger = 0
        self.socket.bind(_ADDRESS)
        self._admit = admit

    def answer(self) -> None:
        """Answer one request, if there is one."""
        try:
            frames = self.socket.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return
        user = self._admit(*_introduction(frames)) if len(frames) > 5 else None
        code, text = (b"200", b"OK") if user else (b"400", b"not known here")
        self.socket.send_multipart([*frames[:2], code, text, (user or "").encode(), b""])

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


def _introduction(frames: list[bytes]) -> tuple[str, str, str, str]:
    """The parts of a request: version, request, domain, address, routing id, mechanism, credentials."""
    key = z85.encode(frames[6]).decode() if frames[5] == b"CURVE" and len(frames) > 6 and len(frames[6]) == 32 else ""
    domain, address, mechanism = (frames[at].decode("utf-8", "replace") for at in (2, 3, 5))
    return domain, address, mechanism, key
