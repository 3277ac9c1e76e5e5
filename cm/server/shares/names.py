# SPDX-License-Identifier: Apache-2.0
"""The names of clients, the places of their connections, and the trackers of what they are sent."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Protocol


class Peer(Protocol):
    """The peer of an open connection (`cm.device.native.guard.Peer`)."""

    @property
    def pid(self) -> int:
        """The pid of a process of this machine, -1 in a container of its own; 0: it is on another machine."""

    @property
    def address(self) -> bytes:
        """In that case its address: IPv6, or IPv4 mapped into it."""


class Who(Protocol):
    """The sender of a message (`cm.server.rights.principal.Principal`)."""

    @property
    def pid(self) -> int | None:
        """The pid of a process of this machine."""

    @property
    def address(self) -> str:
        """Of a client elsewhere."""

    @property
    def name(self) -> str:
        """The name of a user or of a key."""

    @property
    def key(self) -> str:
        """Public, Z85."""

    @property
    def account(self) -> str:
        """All connections of a user, of a key, or of an address together."""


class Tracker(Protocol):
    """The tracker of a message that was passed to ZeroMQ (`zmq.MessageTracker`)."""

    @property
    def done(self) -> bool:
        """Whether it has left."""


def place_of(peer: Peer) -> str:
    """Where a connection comes from: ``pid 123``, or an address."""
    if peer.pid:
        return f"pid {peer.pid}" if peer.pid > 0 else "a process of another container"
    address = ipaddress.IPv6Address(peer.address)
    return str(address.ipv4_mapped or address)


def name_of(who: Who) -> str:
    """A client's name for people: ``pid 123 (python3)``, ``key laptop``, or an address."""
    if who.pid is None:
        return f"key {who.name or who.key}" if who.key else who.address or "somebody"
    try:
        return f"pid {who.pid} ({Path(f'/proc/{who.pid}/comm').read_text('utf-8', 'replace').strip()})"
    except OSError:
        return f"pid {who.pid}"
