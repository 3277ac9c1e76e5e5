# SPDX-License-Identifier: Apache-2.0
"""A peer on DDS for tests of the bridge: listens, publishes and calls services, on this machine's loopback only."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import struct
from pathlib import Path
from typing import Any

from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from ros_peer import PATIENCE, BridgeProcess, ListeningPeer

from cm import child
from cm.dds.graph import gid
from cm.dds.local import loopback
from cm.dds.qos import qos
from cm.dds.transport import DdsTransport
from cm.ros import cdr
from cm.ros.node import NodeName
from cm.ros.transport import SERVICES
from cm.ros.typehash import type_hash

_CLAIM = socket.socket(socket.AF_UNIX)  # its name claims a domain for as long as this process lives


@functools.cache
def domain() -> int:
    """A domain that no other test run on this machine uses: nodes of the same name would answer for each other.

    From 102 on a domain has ports that Linux hands out by itself.
    """
    first = os.getpid()
    for number in (1 + (first + i) % 100 for i in range(100)):
        with contextlib.suppress(OSError):
            _CLAIM.bind(f"\0cm-tests-dds-{number}")
            return number
    raise AssertionError("a hundred runs of tests at once have all domains")


class Bridge(BridgeProcess):
    """`cm bridge dds` as a process."""

    def __init__(self, runtime: Path, *arguments: str) -> None:
        environment = {**child.environment(), "CYCLONEDDS_URI": loopback(), "ROS_DOMAIN_ID": str(domain())}
        super().__init__("dds", runtime, arguments, environment)


class Peer(ListeningPeer):
    """One of our nodes on DDS."""

    transport: DdsTransport

    def __init__(self) -> None:
        os.environ["CYCLONEDDS_URI"] = loopback()
        self.transport = DdsTransport(NodeName("peer"), domain())
        self.participant = self.transport._participant

    def client(self, name: str, kind: str) -> Client:
        """Calls a service."""
        return Client(self, name, kind)

    def call(self, name: str, kind: str, **request: Any) -> dict[str, Any]:
        """Call a service once."""
        return self.client(name, kind).call(request)


class Client:
    """A service's client like rmw_cyclonedds': its writer's id and a count precede each request."""

    def __init__(self, peer: Peer, name: str, kind: str) -> None:
        self._asked, self._replied = f"{kind}_Request", f"{kind}_Response"
        mark = "clientid=" + ".".join(f"{byte:x}" for byte in os.urandom(16)) + ";"
        topic = peer.transport._topic
        self._writer = DataWriter(
            peer.participant,
            topic(f"rq{name}Request", self._asked, True),
            qos=qos(SERVICES, type_hash(self._asked), mark),
        )
        self._reader = DataReader(
            peer.participant,
            topic(f"rr{name}Reply", self._replied, True),
            qos=qos(SERVICES, type_hash(self._replied), mark),
        )
        self._guid = int.from_bytes(gid(self._writer)[8:], "little")
        self._count = 0
        self._await_match()

    def _await_match(self) -> None:
        from manager_process import until

        def matched() -> bool:
            ours = self._writer.get_publication_matched_status().current_count
            return bool(ours and self._reader.get_subscription_matched_status().current_count)

        until(matched, PATIENCE)

    def send(self, request: dict[str, Any]) -> int:
        """Send a request and return its number."""
        from cyclonedds._clayer import ddspy_write

        self._count += 1
        sample = bytearray(cdr.HEADER) + struct.pack("<Qq", self._guid, self._count)
        cdr.put(self._asked, sample, request)
        assert ddspy_write(self._writer._ref, bytes(sample).ljust(len(sample) + -len(sample) % 4, b"\0")) >= 0
        return self._count

    def receive(self, number: int, seconds: float = PATIENCE) -> dict[str, Any] | None:
        """The reply to a request; None if none comes."""
        from cyclonedds.util import duration

        for sample in self._reader.take_iter(timeout=duration(seconds=seconds)):
            reader = cdr.Reader(sample.data)
            if (reader.take("Q", 8), reader.take("q", 8)) == (self._guid, number):
                return cdr.read(self._replied, reader)
        return None

    def call(self, request: dict[str, Any]) -> dict[str, Any]:
        """Ask and wait; repeat, as users do, because the service may not have discovered us at first."""
        for _ in range(4):
            reply = self.receive(self.send(request), PATIENCE / 4)
            if reply is not None:
                return reply
        raise AssertionError(f"no reply of {self._replied} came")
