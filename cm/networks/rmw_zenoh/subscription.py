# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to topics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import zenoh

from cm.networks.rmw_zenoh.inbox import Inbox
from cm.networks.rmw_zenoh.keys import EndKey


class ZenohSubscription:
    """`take` gets each message as it lies on the wire, in a thread of this subscription's own."""

    def __init__(
        self, session: Any, end: EndKey, take: Callable[[bytes], None], closed: Callable[[ZenohSubscription], None]
    ) -> None:
        self._closed = closed
        self._inbox = Inbox(end.topic, end.quality.depth, lambda sample: take(sample.payload.to_bytes()))
        handler = zenoh.handlers.Callback(self._inbox.put, indirect=False)
        declare = _late if end.quality.latched else _plain
        self._subscriber = declare(session, end, handler)
        self._token: Any = session.liveliness().declare_token(end.token)

    def close(self) -> None:
        """End it; twice is fine."""
        token, self._token = self._token, None
        if token is not None:
            token.undeclare()
            self._subscriber.undeclare()
            self._inbox.close()
            self._closed(self)


def _plain(session: Any, end: EndKey, handler: Any) -> Any:
    return session.declare_subscriber(end.key, handler)


def _late(session: Any, end: EndKey, handler: Any) -> Any:
    """Asks publishers for what they sent before."""
    recovery = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if end.quality.reliable else None
    history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=end.quality.depth)
    return zenoh.ext.declare_advanced_subscriber(
        session, end.key, handler, history=history, recovery=recovery, subscriber_detection=True
    )
