# SPDX-License-Identifier: Apache-2.0
"""Topics and services of a node over zenoh, named and marked as rmw_zenoh has them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any
from weakref import WeakSet

import zenoh

from cm.networks.rmw_zenoh.endpoints import Service, ZenohPublisher, ZenohSubscription, hand_on
from cm.networks.rmw_zenoh.interfaces import type_hash
from cm.networks.rmw_zenoh.key_expressions import End, EndKey, NodeKey
from cm.networks.rmw_zenoh.session import opened
from cm.networks.rmw_zenoh.threads import Inbox, Workers
from cm.networks.ros.node import NodeName
from cm.networks.ros.transport import SERVICES, Body, Qos, Values

_REQUESTS = 32  # that are worked on at a time
_WAITING = 1000  # requests that wait; if there are more, the oldest get no answer


class ZenohTransport:
    """One session with one node. Raises InvalidRequest where zenoh does not start."""

    def __init__(self, name: NodeName, domain: int, router: str = "") -> None:
        self._session = opened(router)
        self._node = NodeKey(domain, str(self._session.info.zid()), name.name, name.namespace)
        self._numbers = itertools.count(self._node.number + 1)
        self._workers = Workers(_REQUESTS)
        self._requests = Inbox("services", _WAITING, lambda asked: asked[0].take(asked[1]))
        self._open = WeakSet[ZenohPublisher | ZenohSubscription]()
        self._tokens = [self._session.liveliness().declare_token(self._node.token)]
        self._queryables: list[Any] = []

    # ---- topics ---------------------------------------------------------------------------

    def publisher(self, topic: str, kind: str, quality: Qos) -> ZenohPublisher:
        made = ZenohPublisher(self._session, self._end(End.PUBLISHER, topic, kind, quality))
        self._open.add(made)
        return made

    def frames(
        self, topic: str, kind: str, quality: Qos, take: Callable[[dict[str, Any], Body], None]
    ) -> ZenohSubscription:
        """Listen to a topic of frames, each copied twice: by zenoh's Python API, and to where it is wanted."""
        end = self._end(End.SUBSCRIPTION, topic, kind, quality)
        made = ZenohSubscription(self._session, end, lambda message: hand_on(kind, message, take))
        self._open.add(made)
        return made

    # ---- services -------------------------------------------------------------------------

    def service(self, name: str, kind: str, answer: Callable[[dict[str, Any]], Values]) -> None:
        end = self._end(End.SERVICE, name, kind, SERVICES)
        service = Service(end, answer, self._workers)
        handler: Any = zenoh.handlers.Callback(lambda query: self._requests.put((service, query)), indirect=False)
        self._queryables.append(self._session.declare_queryable(end.key, handler, complete=True))
        self._tokens.append(self._session.liveliness().declare_token(end.token))

    # ---- ends -----------------------------------------------------------------------------

    def _end(self, end: End, topic: str, kind: str, quality: Qos) -> EndKey:
        return EndKey(self._node, next(self._numbers), end, topic, kind, type_hash(kind), quality)

    def close(self) -> None:
        while self._tokens:
            self._tokens.pop().undeclare()
        while self._queryables:
            self._queryables.pop().undeclare()
        self._workers.close()
        self._requests.close()
        for end in tuple(self._open):
            end.close()
        self._session.close()
