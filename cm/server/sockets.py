# SPDX-License-Identifier: Apache-2.0
"""The manager's ZeroMQ sockets: bound in the runtime folder, and over TCP when asked for; who may enter; and the loop
that waits for them.

ZAP is ZeroMQ's authentication protocol (ZMTP RFC 27, ZAP 1.0). pyzmq's own authenticators need a thread or an asyncio
loop of their own, and know no peers over ipc.

In the loop one socket, that of requests, is waited for by `zmq_poll`, which looks at its state before and after; all
else by the epoll, which `zmq_poll` waits for as well. That is half the cost per message of a `zmq.Poller` with all of
them (docs/performance.md).

A ZeroMQ socket's descriptor only says that something changed since the socket was last used in any way, sending
included (zmq_getsockopt(3), ZMQ_FD). So a socket behind the epoll is read until it has nothing more, and checked again
after anything was sent on it from elsewhere: by `Loop.send`.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import zmq
from zmq import zmq_poll
from zmq.utils import z85

from cm.errors import InvalidRequest
from cm.frozen import dataclass, names
from cm.loop import Callback
from cm.loop import Loop as EventLoop
from cm.server.private_folders import open_inside, share
from cm.server.rights.model import Security
from cm.server.rights.principal import CURVE, IPC, TCP
from cm.server.settings.model import USUAL, Limits
from cm.wire import multipart
from cm.wire.plane_packets import SOCKET
from cm.wire.topics import Endpoints, ipc_endpoints, split_tcp, tcp_endpoints

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


ENDPOINTS_FILE = "endpoints.json"
_TRIES = 64  # tries of ports, until three in a row are free
_LAST = 65533  # the first of the last three
_HANDSHAKE = 10_000  # milliseconds for which a connection may stay silent
_TOPIC = 512  # bytes of a subscription, and of a handshake
_WAITING = 16  # messages of each connection that wait to be read


class Sockets:
    """XPUB, SUB and ROUTER, bound. `waiting`: messages that may wait for each slow subscriber.

    `group`: whose members may connect in the runtime folder; None: that of this process.
    """

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        runtime_dir: Path,
        waiting: int,
        limits: Limits = USUAL,
        group: int | None = None,
    ) -> None:
        self._folder = runtime_dir
        self._group = group
        self.ipc = ipc_endpoints(runtime_dir)
        self.pub = context.socket(zmq.XPUB)
        self.sub = context.socket(zmq.SUB)
        self.req = context.socket(zmq.ROUTER)
        self.pub.setsockopt(zmq.XPUB_VERBOSE, 1)  # every new subscriber gets the status at once
        self.pub.setsockopt(zmq.SNDHWM, waiting)  # before it is bound, and never after: see publisher.py
        self.pub.setsockopt(zmq.XPUB_NODROP, 1)  # tells of a full queue; see publisher.py
        self.sub.setsockopt(zmq.SUBSCRIBE, b"cm_")
        # No client can take another's replies by its routing id: while the first connection with that id lasts, a
        # second one gets none. Clients that set no id, as ours, get one from ROUTER.
        self.req.setsockopt(zmq.ROUTER_HANDOVER, 0)
        self.req.setsockopt(zmq.SNDHWM, 0)  # replies are bounded by bytes: see cm/server/client_quotas.py
        for socket in self.all:
            socket.setsockopt(zmq.LINGER, 0)  # a client that does not read must not keep the manager from ending
            socket.setsockopt(zmq.IPV6, 1)
            socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
            socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)  # without an answer from our authenticator, nobody may enter
            socket.setsockopt(zmq.MAXMSGSIZE, limits.message_bytes)
            socket.setsockopt(zmq.HANDSHAKE_IVL, _HANDSHAKE)
            socket.setsockopt(zmq.RCVHWM, _WAITING)
        self.pub.setsockopt(zmq.MAXMSGSIZE, _TOPIC)
        self.tcp: list[Endpoints] = []

    @property
    def all(self) -> tuple[zmq.Socket[bytes], ...]:
        """The three sockets."""
        return self.pub, self.sub, self.req

    def bind_ipc(self) -> None:
        """Bind in the runtime folder; sockets left by a killed manager are replaced (the folder is locked)."""
        for socket, address in zip(self.all, (self.ipc.pub, self.ipc.sub, self.ipc.req), strict=True):
            path = Path(address.removeprefix("ipc://"))
            path.unlink(missing_ok=True)
            self._name(socket, IPC)
            _bind(socket, address)
            share(path, self._group)

    def bind_tcp(self, address: str, security: Security | None) -> Endpoints:
        """Bind three ports in a row, from any that are free for port 0; returns where. Raises InvalidRequest."""
        self._secure(security)
        host, port = split_tcp(address)
        if port:
            bound = tcp_endpoints(address)
            for socket, endpoint in zip(self.all, (bound.pub, bound.sub, bound.req), strict=True):
                _bind(socket, endpoint)
        else:
            bound = self._bind_any(host)
        self.tcp.append(bound)
        return bound

    def _bind_any(self, host: str) -> Endpoints:
        """Bind free ports: clients get one port and use the next two as well, so three in a row have to be free."""
        for _ in range(_TRIES):
            _bind(self.pub, f"tcp://{host}:0")
            first = self.pub.getsockopt_string(zmq.LAST_ENDPOINT)
            port = int(first.rpartition(":")[2])
            wanted = tcp_endpoints(f"tcp://{host}:{min(port, _LAST)}")
            try:
                _bind(self.sub, wanted.sub)
                _bind(self.req, wanted.req)
            except InvalidRequest:
                for socket, bound in ((self.pub, first), (self.sub, wanted.sub)):
                    with suppress(zmq.ZMQError):  # it was not bound
                        socket.unbind(bound)
                continue
            return wanted
        raise InvalidRequest(f"cannot listen on tcp://{host}:0: no three ports in a row are free")

    def _name(self, socket: zmq.Socket[bytes], transport: str) -> None:
        """The name that the authenticator gets for connections to sockets bound from now on."""
        socket.setsockopt_string(zmq.ZAP_DOMAIN, f"{transport} pub" if socket is self.pub else transport)

    def _secure(self, security: Security | None) -> None:
        """Set keys for sockets that are bound from now on."""
        for socket in self.all:
            self._name(socket, TCP if security is None else CURVE)
            if security is not None:
                socket.curve_server = True
                socket.curve_publickey = security.public_key
                socket.curve_secretkey = security.secret_key

    def announce(self) -> None:
        """Write where this manager listens, for clients and people."""
        ipc, *tcp = ({name: getattr(ends, name) for name in names(ends)} for ends in (self.ipc, *self.tcp))
        listens = {"ipc": ipc, "tcp": tcp, "data": str(self._folder / SOCKET)}
        text = json.dumps({"pid": os.getpid(), **listens}, indent=1)
        new = self._folder / (ENDPOINTS_FILE + ".new")
        with os.fdopen(open_inside(self._folder, new.name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), "w") as file:
            file.write(text + "\n")
        share(new, self._group, 0o640)
        new.replace(self._folder / ENDPOINTS_FILE)

    def close(self) -> None:
        """Close, and remove our files in the runtime folder."""
        for socket in self.all:
            socket.close()
        for name in ("pub", "sub", "req", ENDPOINTS_FILE):
            with suppress(OSError):  # the others go all the same; what stays, the next manager replaces
                (self._folder / name).unlink(missing_ok=True)


def _bind(socket: zmq.Socket[bytes], address: str) -> None:
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        raise InvalidRequest(f"cannot listen on {address}: {error}") from error


_LOG = logging.getLogger(__name__)
_POLLIN = int(zmq.POLLIN)  # arithmetic on the enumeration costs more than the call
_TURNS = 16  # requests that one socket may have served before others get their turn


@dataclass(frozen=True, slots=True, eq=False)
class _Watched:
    """A ZeroMQ socket, and what takes one message off it."""

    sources: list[tuple[Any, int]]  # the socket, as `zmq_poll` takes it
    take: Callback


class Loop(EventLoop):
    """An event loop that a defect in a callback does not end: it is logged."""

    def __init__(self) -> None:
        super().__init__()
        self._sockets: dict[zmq.Socket[bytes], _Watched] = {}
        self._waited: list[tuple[Any, int]] = [(self._epoll.fileno(), _POLLIN)]  # as `zmq_poll` takes it
        self._takes: dict[Any, Callback] = {self._epoll.fileno(): partial(self._serve, 0)}  # of what is waited for
        self._unread: set[_Watched] = set()  # may have messages that their descriptors do not show

    def add_socket(self, socket: zmq.Socket[bytes], take: Callback, foremost: bool = False) -> None:
        """Call `take` when there are messages; it reads one or more from the socket.

        A `foremost` one costs less per message of its own, and a little with every other event.
        """
        if foremost:
            self._waited.append((socket, _POLLIN))
            self._takes[socket] = take
            return
        watched = self._sockets[socket] = _Watched([(socket, _POLLIN)], take)
        self.add(socket.fileno(), partial(self._drain, watched))
        self._unread.add(watched)

    def send(self, socket: zmq.Socket[bytes], frames: Sequence[bytes | memoryview], flags: int = 0) -> None:
        """Send on a socket that is watched; the loop looks at it again before it waits."""
        watched = self._sockets.get(socket)
        if watched is not None:
            self._unread.add(watched)
        multipart.send(socket, frames, flags)

    def _wait(self, milliseconds: int) -> None:
        taken = False
        for watched in tuple(self._unread) if self._unread else ():  # this may set new timers
            taken = self._drain(watched) or taken
        for source, _ in zmq_poll(self._waited, 0 if taken or self._unread else milliseconds):
            try:
                self._takes[source]()
            except Exception as error:  # noqa: BLE001 (see _failed)
                self._failed(error)

    def _drain(self, watched: _Watched) -> bool:
        """Serve a socket until it has nothing more, or for its share; returns whether it had something."""
        for turn in range(_TURNS):
            if not zmq_poll(watched.sources, 0):  # half the time of asking for ZMQ_EVENTS
                self._unread.discard(watched)
                return turn > 0
            self._guarded(watched.take)
        self._unread.add(watched)
        return True

    def _failed(self, error: Exception) -> None:
        _LOG.error("a callback failed", exc_info=error)
