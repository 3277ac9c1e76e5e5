# SPDX-License-Identifier: Apache-2.0
"""The sockets of a manager, played in a thread: what a client sends is checked and kept; the case answers."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zmq
from zmq.utils import z85

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire.decode import decode_request
from cm.wire.envelope import split_envelope
from cm.wire.messages.requests import Request

_POLL = 50  # milliseconds between two checks for the end


@dataclass(frozen=True, slots=True)
class Taken:
    """A request as it came: the frames that lead back, its topic, and what it asks."""

    envelope: tuple[bytes, ...]
    topic: str
    request: Request
    payload: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """CURVE: the manager's key pair, and the public keys of those who may connect."""

    public: bytes
    secret: bytes
    clients: frozenset[bytes]


Play = Callable[["ActingManager", Taken], None]
Listens = Callable[["ActingManager", str], None]


class ActingManager:
    """Serves while the context lasts. `play` answers requests, `listens` is told of subscriptions, in its thread."""

    def __init__(self, folder: Path, play: Play, listens: Listens, keys: ServerKeys | None = None) -> None:
        self.folder = folder
        self.taken: list[Taken] = []
        self.violations: list[str] = []
        self.endpoint = ""
        self._play, self._listens, self._keys = play, listens, keys
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._ending = threading.Event()  # what has been sent by then is still read
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="cm-manager")

    def __enter__(self) -> ActingManager:
        self._bind()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.vanish()
        self._context.destroy(linger=0)

    # ---- for cases ----------------------------------------------------------------------------

    def reply(self, to: Taken, *payload: bytes, **body: Any) -> None:
        """Answer a request: ``reply(taken, status=…)``; an error with ``error=``."""
        message = pb.Reply(ok="error" not in body, sequence=1, **body)
        self.reply_raw(to, message.SerializeToString(), *payload)

    def reply_raw(self, to: Taken, message: bytes, *payload: bytes) -> None:
        """Answer with these bytes."""
        self._req.send_multipart([*to.envelope, to.topic.encode(), message, *payload])

    def publish(self, topic: str, message: Any, *payload: bytes) -> None:
        """Tell all who subscribed."""
        self._pub.send_multipart([topic.encode(), message.SerializeToString(), *payload])

    def vanish(self) -> None:
        """Vanish as a manager that is killed: its sockets close, and nothing is said."""
        for socket in (self._req, self._pub, self._sub):
            socket.close(0)
        self._over.set()

    # ---- the thread ---------------------------------------------------------------------------

    def _bind(self) -> None:
        self._req, self._pub, self._sub = (self._context.socket(k) for k in (zmq.ROUTER, zmq.XPUB, zmq.SUB))
        self._sub.setsockopt(zmq.SUBSCRIBE, b"")
        self._authenticator = self._authenticated() if self._keys else None
        places = {}
        for name, socket in (("pub", self._pub), ("sub", self._sub), ("req", self._req)):
            places[name] = f"ipc://{self.folder}/{name}"
            if not self._keys:
                socket.bind(places[name])
        told: dict[str, Any] = {"pid": os.getpid(), "ipc": places, "tcp": [], "data": str(self.folder / "data")}
        if self._keys:
            told["tcp"] = [self._bind_tcp(self._keys)]
        (self.folder / "endpoints.json").write_text(json.dumps(told), encoding="utf-8")

    def _bind_tcp(self, keys: ServerKeys) -> dict[str, str]:
        """Three ports in a row, as clients expect them."""
        for socket in (self._pub, self._sub, self._req):
            socket.curve_server = True
            socket.curve_publickey, socket.curve_secretkey = keys.public, keys.secret
            socket.zap_domain = b"cm"
        while (first := self._three_in_a_row()) is None:
            pass
        self.endpoint = f"tcp://127.0.0.1:{first}"
        return {n: f"tcp://127.0.0.1:{first + i}" for i, n in enumerate(("pub", "sub", "req"))}

    def _three_in_a_row(self) -> int | None:
        """The first of three ports that were free; None if one of them is in use."""
        first = self._pub.bind_to_random_port("tcp://127.0.0.1")
        bound = [(self._pub, f"tcp://127.0.0.1:{first}")]
        for offset, socket in enumerate((self._sub, self._req), 1):
            bound.append((socket, f"tcp://127.0.0.1:{first + offset}"))
            try:
                socket.bind(bound[-1][1])
            except zmq.ZMQError:
                for other, address in bound[:-1]:
                    other.unbind(address)
                return None
        return first

    def _authenticated(self) -> zmq.Socket[bytes]:
        socket = self._context.socket(zmq.REP)
        socket.bind("inproc://zeromq.zap.01")
        return socket

    def _serve(self) -> None:
        poller = zmq.Poller()
        for socket in filter(None, (self._req, self._pub, self._sub, self._authenticator)):
            poller.register(socket, zmq.POLLIN)
        while not self._over.is_set():
            ready = poller.poll(_POLL)
            if not ready and self._ending.is_set():
                break
            for socket, _ in ready:
                if not self._over.is_set():
                    self._handle(socket)
        if self._authenticator is not None:
            self._authenticator.close(0)

    def _handle(self, socket: Any) -> None:
        if socket is self._authenticator:
            self._admit(socket)
        elif socket is self._pub:
            event = socket.recv()
            if event[:1] == b"\x01":
                self._listens(self, event[1:].decode())
        elif socket is self._sub:
            self._take((), [bytes(f) for f in socket.recv_multipart()])
        else:
            envelope, message = split_envelope(socket.recv_multipart())
            self._take(tuple(bytes(f) for f in envelope), [bytes(f) for f in message])

    def _admit(self, socket: Any) -> None:
        frames = socket.recv_multipart()
        known = self._keys is not None and z85.encode(frames[6]) in self._keys.clients
        socket.send_multipart(
            [frames[0], frames[1], *((b"200", b"OK") if known else (b"400", b"unknown key")), b"", b""]
        )

    def _take(self, envelope: tuple[bytes, ...], frames: list[bytes]) -> None:
        try:
            request = decode_request(frames)
        except InvalidRequest as error:
            self.violations.append(f"what was sent is not a request: {error}")
            return
        topic = frames[0].decode().partition(" ")[0]
        taken = Taken(envelope, topic, request, tuple(frames[2:]))
        self.taken.append(taken)
        self._play(self, taken)
