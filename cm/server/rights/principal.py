# SPDX-License-Identifier: Apache-2.0
"""Who a request comes from, whatever way it came."""

from __future__ import annotations

from cm.frozen import dataclass, replace

IPC, CURVE, TCP, DATA = "ipc", "curve", "tcp", "data"  # kinds of connection; `data`: frames without copies
GUEST = "for"  # begins the id of a guest: a client that a bridge speaks for


@dataclass(frozen=True, slots=True)
class Principal:
    """A process of this machine, the holder of a key, or a client over TCP without one.

    `id` is the same for all requests of one connection, and accompanies each of its messages (ZMQ's User-Id). `name` is
    a user's, or that of the key's file. `via`: the id of a bridge that speaks for `name`.
    """

    id: str
    transport: str
    name: str = ""
    uid: int | None = None  # uid, gid, pid: of a process of this machine
    gid: int | None = None
    pid: int | None = None
    key: str = ""  # public, Z85
    address: str = ""  # over TCP
    via: str = ""

    @property
    def account(self) -> str:
        """The key of its budget: all connections of a user, of a key, or of an address together."""
        if self.via:
            return f"for:{self.name}"
        if self.uid is not None:
            return f"uid:{self.uid}"
        return f"key:{self.name or self.key}" if self.key else f"{self.transport}:{self.address}"

    def __str__(self) -> str:
        """As logs have it."""
        if self.via:
            return f"{printable(self.name)} through {self.via}"
        if self.uid is not None:
            return f"{printable(self.name) or 'user'} (uid {self.uid}, pid {self.pid})"
        if self.key:
            return f"key {printable(self.name) or self.key}"
        return f"{self.address or 'somebody'} without a key"


NOBODY = Principal("", "")


def of_process(transport: str, uid: int, gid: int, pid: int) -> Principal:
    """The process as the kernel describes it; its name is looked up where users are known."""
    return Principal(f"{transport}:{uid}:{gid}:{pid}", transport, uid=uid, gid=gid, pid=pid)


def introduced(domain: str, address: str, mechanism: str, key: str) -> Principal:
    """The peer that ZeroMQ's authentication (ZAP) describes; NOBODY if it does not say enough.

    Over ipc libzmq passes on what the kernel says of the peer, as an address that ends in :UID:GID:PID.
    """
    if domain == IPC and mechanism == "NULL":
        numbers = address.split(":")[-3:]
        if len(numbers) == 3 and all(n.isdecimal() for n in numbers):
            return of_process(IPC, *map(int, numbers))
    elif domain == CURVE and mechanism == "CURVE" and key:
        return Principal(f"{CURVE}:{address}:{key}", CURVE, key=key, address=address)
    elif domain == TCP and mechanism == "NULL":
        return Principal(f"{TCP}:{address}", TCP, address=address)
    return NOBODY


def from_id(text: str) -> Principal:
    """The principal that has an id."""
    transport, _, rest = text.partition(":")
    if transport in (IPC, DATA):
        numbers = rest.split(":")
        if len(numbers) == 3 and all(n.isdecimal() for n in numbers):
            return of_process(transport, *map(int, numbers))
    elif transport == CURVE:
        key = rest[-40:]
        return introduced(CURVE, rest[:-41], "CURVE", key) if len(rest) > 40 else NOBODY
    elif transport == TCP:
        return introduced(TCP, rest, "NULL", "")
    return NOBODY


def on_behalf(bridge: Principal, name: str) -> Principal:
    """A client that a bridge speaks for."""
    return replace(bridge, id=f"{GUEST}:{len(name)}:{name}:{bridge.id}", name=name, via=bridge.id)


def guest_of(connection: str) -> tuple[str, str]:
    """The name of a guest, and the id of its bridge; empty where an id is not that of one."""
    kind, _, rest = connection.partition(":")
    length, _, rest = rest.partition(":")
    if kind != GUEST or not length.isdecimal():
        return "", ""
    return rest[: int(length)], rest[int(length) + 1 :]


def printable(text: str) -> str:
    """Text from outside as it may stand in a line of a log or of a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[:200])
