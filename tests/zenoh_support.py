# SPDX-License-Identifier: Apache-2.0
"""A zenoh router and peers for tests of the bridge to nodes of rmw_zenoh, on this machine's loopback alone."""

from __future__ import annotations

import os
import queue
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh

from cm import child
from cm.fleet.network import Network, session
from cm.rmw_zenoh.attachment import Attachment
from cm.rmw_zenoh.keys import End
from cm.rmw_zenoh.transport import ZenohTransport
from cm.ros import cdr
from cm.ros.node import NodeName
from cm.ros.transport import SERVICES, Qos

PATIENCE = 60.0
DOMAIN = 7


class Router:
    """zenoh's, in this process."""

    def __init__(self) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        self.where = f"127.0.0.1:{self.port}"
        self._session = session(Network("router", (), (f"tcp/{self.where}",)))

    def close(self) -> None:
        self._session.close()


class Bridge:
    """`cm bridge rmw-zenoh` as a process; `direct`: as rmw_zenoh's own nodes, it but meets others by the router."""

    def __init__(self, runtime: Path, router: str, *arguments: str, direct: bool = False) -> None:
        environment = {**child.environment(), "ROS_DOMAIN_ID": str(DOMAIN)}
        environment.pop("ZENOH_CONFIG_OVERRIDE", None)  # of a ROS that runs these tests
        words = child.command("cm.cli.main", "bridge", "rmw-zenoh", "--runtime-dir", str(runtime), *arguments)
        if direct:
            environment["ZENOH_CONFIG_OVERRIDE"] = f'connect/endpoints=["tcp/{router}"]'
        else:
            words += ["--router", router]
        self.process = subprocess.Popen(words, stderr=subprocess.PIPE, env=environment)
        assert self.process.stderr is not None
        self.log = b""
        while b"cm bridge: /" not in self.log:
            ready, _, _ = select.select([self.process.stderr], [], [], PATIENCE)
            piece = os.read(self.process.stderr.fileno(), 65536) if ready else b""
            assert piece, f"the bridge did not start: {self.log.decode()}"
            self.log += piece

    def stop(self) -> tuple[int, str]:
        """Its status, and what it said."""
        self.process.send_signal(signal.SIGINT)
        _, rest = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, (self.log + rest).decode()


class Peer:
    """A node of ours on the other side."""

    def __init__(self, router: str) -> None:
        self.transport = ZenohTransport(NodeName("peer"), DOMAIN, router)
        self.session = self.transport._session

    @contextmanager
    def listening(self, topic: str, kind: str, quality: Qos) -> Iterator[queue.Queue[dict[str, Any]]]:
        """What comes on a topic."""
        found: queue.Queue[dict[str, Any]] = queue.Queue()
        subscription = self.transport.subscription(topic, kind, quality, found.put)
        try:
            yield found
        finally:
            subscription.close()

    def next(self, topic: str, kind: str, quality: Qos, fits: Callable[[Any], bool] = lambda _: True) -> dict[str, Any]:
        """The first message on a topic that fits."""
        with self.listening(topic, kind, quality) as found:
            while True:
                values = found.get(timeout=PATIENCE)
                if fits(values):
                    return values

    def ask(self, name: str, kind: str, payload: bytes, attachment: bytes | None) -> Any:
        """A service's first answer to bytes, as rmw_zenoh's clients ask: of all that are complete."""
        key = self.transport._end(End.CLIENT, name, kind, SERVICES).key
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:  # the service may not be known here yet
            replies = self.session.get(
                key,
                payload=payload,
                attachment=attachment,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=PATIENCE,
            )
            for reply in replies:
                return reply
        raise AssertionError(f"nobody answers {key}")

    def call(self, name: str, kind: str, **request: Any) -> dict[str, Any]:
        """Call a service once."""
        asked = Attachment(5, time.time_ns(), bytes(range(16)))
        reply = self.ask(name, kind, cdr.encode(f"{kind}_Request", request), asked.to_bytes()).ok
        answered = Attachment.from_bytes(reply.attachment.to_bytes())
        assert (answered.number, answered.gid) == (asked.number, asked.gid)
        return cdr.decode(f"{kind}_Response", reply.payload.to_bytes())

    def close(self) -> None:
        self.transport.close()
