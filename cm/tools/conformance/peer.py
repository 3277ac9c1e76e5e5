# SPDX-License-Identifier: Apache-2.0
"""Bare sockets to a manager, and the error for a promise that is not kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import zmq

from cm.client.find_manager import Keys
from cm.errors import Timeout
from cm.wire import cm_pb2 as pb
from cm.wire.topics import Endpoints

_WAIT = 60_000  # milliseconds for an answer


class Peer:
    """Sockets as a program in any language has them."""

    def __init__(self, endpoints: Endpoints, keys: Keys | None) -> None:
        self._endpoints, self._keys = endpoints, keys
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()

    @contextmanager
    def socket(self, kind: int, address: str) -> Iterator[zmq.Socket[bytes]]:
        """A socket that is connected."""
        socket = self._context.socket(kind)
        socket.linger, socket.rcvtimeo = 0, _WAIT
        if self._keys is not None:
            socket.curve_serverkey = self._keys.server_public
            socket.curve_publickey, socket.curve_secretkey = self._keys.public, self._keys.secret
        try:
            socket.connect(address)
            yield socket
        except zmq.Again:
            raise Timeout(f"nothing came from {address} within {_WAIT / 1000:g} s") from None
        finally:
            socket.close()

    @contextmanager
    def dealer(self) -> Iterator[zmq.Socket[bytes]]:
        """A DEALER socket, for several requests at a time."""
        with self.socket(zmq.DEALER, self._endpoints.req) as dealer:
            yield dealer

    def ask(self, topic: str, message: bytes = b"", *payload: bytes) -> pb.Reply:
        """Send a request over a connection of its own."""
        with self.socket(zmq.REQ, self._endpoints.req) as req:
            req.send_multipart([topic.encode(), message, *payload])
            answer = req.recv_multipart()
        check(answer[0] == topic.encode(), f"a reply begins with its topic {topic}, this one with {answer[0]!r}")
        return pb.Reply.FromString(answer[1])

    @contextmanager
    def listening(self, *topics: str) -> Iterator[zmq.Socket[bytes]]:
        """A SUB socket whose subscription has arrived: the first status has come."""
        with self.socket(zmq.SUB, self._endpoints.pub) as sub:
            for topic in (*topics, "cm_status"):
                sub.setsockopt(zmq.SUBSCRIBE, topic.encode())
            until(sub, "cm_status", lambda _: True)
            yield sub

    def close(self) -> None:
        """End it."""
        self._context.destroy(linger=0)


class Broken(AssertionError):
    """A promise that was not kept."""


def check(holds: bool, why: str) -> None:
    if not holds:
        raise Broken(why)


def until(sub: zmq.Socket[bytes], topic: str, accepts: Callable[[bytes], bool]) -> bytes:
    while True:
        frames = sub.recv_multipart()
        if frames[0] == topic.encode() and accepts(frames[1]):
            return frames[1]


def refused(reply: pb.Reply, code: str, says: str = "") -> None:
    check(not reply.ok and reply.error.code == code, f"code {code} is wanted, {reply.error.code or 'ok'!r} came")
    check(says in reply.error.message, f"the sentence should name {says}: {reply.error.message!r}")
