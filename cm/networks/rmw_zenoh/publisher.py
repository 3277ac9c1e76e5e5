# SPDX-License-Identifier: Apache-2.0
"""Topics that are published."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

from cm.networks.bridge.records import FrameRecord
from cm.networks.rmw_zenoh.attachment import Attachment
from cm.networks.rmw_zenoh.keys import EndKey
from cm.networks.ros import cdr
from cm.networks.ros.samples import Gathering
from cm.networks.ros.transport import Values

_HEARTBEAT = 0.5  # seconds, rmw_zenoh's


class ZenohPublisher:
    """A publisher; threads take turns. A frame is copied twice: into the message, and by zenoh's Python API."""

    def __init__(self, session: Any, end: EndKey, closed: Callable[[ZenohPublisher], None]) -> None:
        self._end = end
        self._gid = end.gid
        self._closed = closed
        self._lock = threading.Lock()
        self._number = 0
        self._gathering = Gathering()
        self._plain = session.declare_publisher(end.key, **quality(end))
        self._put = (_latched(session, end) if end.quality.latched else self._plain).put
        self._token: Any = session.liveliness().declare_token(end.token)

    def write(self, values: Values) -> None:
        """One message."""
        message = cdr.encode(self._end.kind, values)
        with self._lock:
            self._send(message)

    def write_frame(self, head: Values, frame: FrameRecord) -> None:
        """A frame as the last field of a message."""
        start = cdr.head(self._end.kind, head, frame.data.nbytes)
        with self._lock:
            self._send(self._gathering.gathered(start, frame.data))

    def _send(self, message: bytes | bytearray) -> None:
        if self._token is not None:
            self._number += 1
            self._put(message, attachment=Attachment(self._number, time.time_ns(), self._gid).to_bytes())

    def listeners(self) -> int:
        """1 if there are subscribers: zenoh does not say how many."""
        with self._lock:
            return int(self._token is not None and self._plain.matching_status.matching)

    def close(self) -> None:
        """End it; twice is fine."""
        with self._lock:
            token, self._token = self._token, None
            if token is None:
                return
            token.undeclare()
            self._put.__self__.undeclare()
            if self._end.quality.latched:
                self._plain.undeclare()
        self._closed(self)


def quality(end: EndKey) -> dict[str, Any]:
    """The quality that rmw_zenoh gives a publisher with history "keep last": it drops what the network cannot take."""
    reliable = end.quality.reliable
    return {
        "congestion_control": zenoh.CongestionControl.DROP,
        "reliability": zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
    }


def _latched(session: Any, end: EndKey) -> Any:
    """A publisher whose last messages are sent to subscribers that come later."""
    reliable = end.quality.reliable
    return zenoh.ext.declare_advanced_publisher(
        session,
        end.key,
        cache=zenoh.ext.CacheConfig(end.quality.depth),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT)
        if reliable
        else None,
        **quality(end),
    )
