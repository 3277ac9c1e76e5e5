# SPDX-License-Identifier: Apache-2.0
"""The manager's ZeroMQ sockets: bound in the runtime folder, and over TCP when asked for; ZAP asks who may enter.

ZAP is ZeroMQ's authentication protocol (ZMTP RFC 27, ZAP 1.0). pyzmq's own authenticators need a thread or an asyncio
loop of their own, and know no peers over ipc.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import zmq
from zmq.utils import z85

from cm.device.base import AnyRoot
from cm.device.paths import Root
from cm.errors import Busy, InvalidRequest
from cm.server.folders import open_inside, own_folder, share
from cm.server.limits import USUAL, Limits
from cm.server.rights.principal import CURVE, IPC, TCP
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


class AlreadyServed(Busy):
    """Another manager serves this runtime folder."""

    code = "already_served"


class FolderLock:
    """An flock on the runtime folder: it ends with the process, however that dies."""

    def __init__(self, folder: Path, group: int | None = None) -> None:
        """Make the folder, for this user and a group. Raises UnsafeFolder for one that is not ours."""
        own_folder(folder, group)
        self._fd = open_inside(folder, "lock", os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            pid = os.read(self._fd, 32).decode("ascii", "replace").strip()
            os.close(self._fd)
            raise AlreadyServed(
                f"a configuration manager (pid {pid}) serves {folder} already; stop it, or choose another --runtime-dir"
            ) from None
        os.ftruncate(self._fd, 0)
        os.write(self._fd, str(os.getpid()).encode())

    def release(self) -> None:
        """Give it back."""
        os.close(self._fd)


class BoardLock:
    """An flock on the board's sysfs: managers with other runtime folders notice each other.

    Nothing is written. It ends with the process, and holds within one mount of sysfs: managers in containers with
    mounts of their own do not see it.
    """

    def __init__(self, root: AnyRoot) -> None:
        folder = Root.of(root).join("sys")
        if not folder.is_dir():
            folder = folder.parent
        self._fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = _holder(self._fd)
            os.close(self._fd)
            raise AlreadyServed(
                f"{holder} holds the board below {folder.parent} already: two managers would load over each other. "
                "Stop it, or give each a board of its own (CM_ROOT)"
            ) from None

    def release(self) -> None:
        """Give it back."""
        os.close(self._fd)


class Locks:
    """Both, held until `release`. Raises AlreadyServed."""

    def __init__(self, folder: Path, root: AnyRoot, group: int | None = None) -> None:
        self._folder = FolderLock(folder, group)
        try:
            self._board = BoardLock(root)
        except BaseException:
            self._folder.release()
            raise

    def release(self) -> None:
        """Give them back."""
        self._board.release()
        self._folder.release()


def _holder(fd: int) -> str:
    """The holder of an flock on a file, as /proc/locks has it."""
    wanted = os.fstat(fd).st_ino
    try:
        lines = Path("/proc/locks").read_text("ascii", "replace").splitlines()
    except OSError:
        lines = []
    for fields in (line.split() for line in lines):
        if len(fields) >= 6 and fields[1] == "FLOCK" and fields[5].rpartition(":")[2] == str(wanted):
            return f"another process (pid {fields[4]})"
    return "another process"


@dataclass(frozen=True, slots=True)
class Security:
    """CURVE keys of the server (Z85, 40 characters)."""

    public_key: bytes
    secret_key: bytes


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
        self.req.setsockopt(zmq.SNDHWM, 0)  # replies are bounded by bytes: see cm/server/shares.py
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
        self.tcp.append(self._bind_all(tcp_endpoints(address)) if port else self._bind_any(host))
        return self.tcp[-1]

    def _bind_all(self, wanted: Endpoints) -> Endpoints:
        for socket, endpoint in zip(self.all, (wanted.pub, wanted.sub, wanted.req), strict=True):
            _bind(socket, endpoint)
        return wanted

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

    def announce(self, metrics: str = "") -> None:
        """Write where this manager listens, for clients and people."""
        listens = {"ipc": asdict(self.ipc), "tcp": [asdict(e) for e in self.tcp], "data": str(self._folder / SOCKET)}
        beside = {"metrics": metrics} if metrics else {}
        text = json.dumps({"pid": os.getpid(), **listens, **beside}, indent=1)
        new = self._folder / (ENDPOINTS_FILE + ".new")
        new.write_text(text + "\n", encoding="utf-8")
        new.replace(self._folder / ENDPOINTS_FILE)

    def close(self) -> None:
        """Close, and remove our files in the runtime folder."""
        for socket in self.all:
            socket.close()
        for name in ("pub", "sub", "req", ENDPOINTS_FILE):
            (self._folder / name).unlink(missing_ok=True)


def _bind(socket: zmq.Socket[bytes], address: str) -> None:
    try:
        socket.bind(address)
    except zmq.ZMQError as error:
        raise InvalidRequest(f"cannot listen on {address}: {error}") from error
