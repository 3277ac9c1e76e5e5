# SPDX-License-Identifier: Apache-2.0
"""Bounds on libzmq's connections (csrc/guard.h). State is the process's, as descriptors are."""

from __future__ import annotations

from typing import NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import check

NONE: int = lib.CM_GUARD_NONE
REQUESTS: int = lib.CM_GUARD_REQUESTS
TOPICS: int = lib.CM_GUARD_TOPICS
CAUSES = ("full", "each", "descriptors", "protocol", "parts", "bytes", "rate", "cut", "slow", "unread", "often")


class Limits(NamedTuple):
    """``struct cm_guard_limits``."""

    connections: int
    each: int
    newcomers: int
    descriptors: int
    parts: int
    bytes: int
    topics: int


class Peer(NamedTuple):
    """``struct cm_guard_peer``; `address` is IPv6, or IPv4 mapped into it, all zero where there is a `pid`."""

    serial: int
    fd: int
    kind: int
    pid: int
    uid: int
    gid: int
    address: bytes


class Counts(NamedTuple):
    """``struct cm_guard_counts``: `refused` by their cause, and the peer that was refused last."""

    connections: int
    refused: dict[str, int]
    last: Peer
    last_cause: str


def install() -> bool:
    """Lead libzmq's calls through the guard; False if that is not possible here."""
    return int(lib.cm_guard_install()) > 0


def limit(limits: Limits) -> None:
    """From now on."""
    lib.cm_guard_limit(ffi.new("struct cm_guard_limits *", limits))


def expect(kind: int) -> None:
    """Declare that listeners which this thread makes from now on are of that kind."""
    lib.cm_guard_expect(kind)


def peers() -> list[Peer]:
    """The peers that are connected, one for each connection."""
    room = ffi.new("struct cm_guard_peer[]", int(counts().connections) + 64)
    return [_peer(room[i]) for i in range(lib.cm_guard_peers(room, len(room)))]


def peer(fd: int) -> Peer:
    """The peer at the other end of a connection; OSError (ENOENT) if the descriptor is not one."""
    found = ffi.new("struct cm_guard_peer *")
    check(lib.cm_guard_peer(fd, found))
    return _peer(found)


def serial(fd: int) -> int:
    """The serial number of a descriptor's connection; 0: the descriptor is not a connection."""
    return int(lib.cm_guard_serial(fd))


def cut(fd: int) -> None:
    """End a connection; OSError (ENOENT) if the descriptor is not one."""
    check(lib.cm_guard_cut(fd))


def taken(fd: int, size: int) -> None:
    """Note that a message was received that has `size` bytes in frames that are not small."""
    lib.cm_guard_taken(fd, size)


def hold(fd: int, held: bool) -> None:
    """Stop or resume reading a connection; OSError (ENOENT) if the descriptor is not one."""
    check(lib.cm_guard_hold(fd, held))


def cut_slowest(kind: int) -> bool:
    """End the connection of this kind that has been unable to write for longest; False if there is none."""
    return int(lib.cm_guard_cut_slowest(kind)) >= 0


def look_on() -> None:
    """Once a second: end connections that keep others from sending long messages."""
    lib.cm_guard_look_on()


def counts() -> Counts:
    """How many there are, and how many were refused."""
    now = ffi.new("struct cm_guard_counts *")
    lib.cm_guard_count(now)
    refused = dict(zip(CAUSES, map(int, now.refused), strict=True))
    return Counts(now.connections, refused, _peer(now.last), CAUSES[now.last_cause])


def _peer(found: object) -> Peer:
    return Peer(found.serial, found.fd, found.kind, found.pid, found.uid, found.gid, bytes(found.address))  # type: ignore[attr-defined]
