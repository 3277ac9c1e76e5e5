# SPDX-License-Identifier: Apache-2.0
"""A zenoh router and peers for tests of the bridge to nodes of rmw_zenoh, on this machine's loopback only."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh
from ros_peer import PATIENCE, BridgeProcess

from cm import child
from cm.networks.fleet.zenoh_session import Network, session
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.key_expressions import Attachment, End
from cm.networks.rmw_zenoh.transport import ZenohTransport
from cm.networks.ros.node import NodeName
from cm.networks.ros.transport import SERVICES, Qos
from cm.tools.demo.boards import free_ports

DOMAIN = 7


class Router:
    """A zenoh router in this process."""

    def __init__(self) -> None:
        self.port = free_ports()
        self.where = f"127.0.0.1:{self.port}"
        self._session = session(Network("router", (), (f"tcp/{self.where}",)))

    def close(self) -> None:
        self._session.close()


class Bridge(BridgeProcess):
    """`cm bridge ros` as a process; `direct`: as rmw_zenoh's own nodes, it but meets others by the router."""

    def __init__(self, runtime: Path, router: str, *arguments: str, direct: bool = False) -> None:
        environment = {**child.environment(), "ROS_DOMAIN_ID": str(DOMAIN)}
        if direct:
            environment["ZENOH_CONFIG_OVERRIDE"] = f'connect/endpoints=["tcp/{router}"]'
        else:
            arguments += ("--router", router)
        super().__init__("ros", runtime, ("--write", "all", *arguments), environment)


class Peer:
    """One of our nodes on the other side; it listens as rmw_zenoh's do."""

    def __init__(self, router: str) -> None:
        self.transport = ZenohTransport(NodeName("peer"), DOMAIN, router)
        self.session = self.transport._session

    @contextmanager
    def listening(self, topic: str, kind: str, quality: Qos) -> Iterator[queue.Queue[dict[str, Any]]]:
        """Listen to a topic."""
        found: queue.Queue[dict[str, Any]] = queue.Queue()
        key = self.transport._end(End.SUBSCRIPTION, topic, kind, quality).key
        take = zenoh.handlers.Callback(
            lambda sample: found.put(cdr.decode(kind, bytes(sample.payload))), indirect=False
        )
        if quality.latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=quality.depth)
            subscriber: Any = zenoh.ext.declare_advanced_subscriber(self.session, key, take, history=history)
        else:
            subscriber = self.session.declare_subscriber(key, take)
        try:
            yield found
        finally:
            subscriber.undeclare()

    def next(self, topic: str, kind: str, quality: Qos, fits: Callable[[Any], bool] = lambda _: True) -> dict[str, Any]:
        """The first message on a topic that fits."""
        with self.listening(topic, kind, quality) as found:
            while True:
                values = found.get(timeout=PATIENCE)
                if fits(values):
                    return values

    def close(self) -> None:
        self.transport.close()

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

    def refused(self, name: str, kind: str, **request: Any) -> bool:
        """Whether a request that a router does not let through gets no answer."""
        key = self.transport._end(End.CLIENT, name, kind, SERVICES).key
        attachment = Attachment(5, time.time_ns(), bytes(range(16))).to_bytes()
        return not list(
            self.session.get(key, payload=cdr.encode(f"{kind}_Request", request), attachment=attachment, timeout=5.0)
        )

    def send(self, name: str, kind: str, **request: Any) -> None:
        """Call a service that was met already, and do not wait."""
        key = self.transport._end(End.CLIENT, name, kind, SERVICES).key
        attachment = Attachment(5, time.time_ns(), bytes(range(16))).to_bytes()
        payload = cdr.encode(f"{kind}_Request", request)
        self.session.get(key, lambda _: None, payload=payload, attachment=attachment, timeout=PATIENCE)

    def call(self, name: str, kind: str, **request: Any) -> dict[str, Any]:
        """Call a service once."""
        asked = Attachment(5, time.time_ns(), bytes(range(16)))
        reply = self.ask(name, kind, cdr.encode(f"{kind}_Request", request), asked.to_bytes()).ok
        answered = Attachment.from_bytes(reply.attachment.to_bytes())
        assert (answered.number, answered.gid) == (asked.number, asked.gid)
        return cdr.decode(f"{kind}_Response", reply.payload.to_bytes())
