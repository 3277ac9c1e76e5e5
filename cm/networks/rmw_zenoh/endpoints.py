# SPDX-License-Identifier: Apache-2.0
"""What a node publishes, listens to and serves, over zenoh, as rmw_zenoh does."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import zenoh

from cm.errors import CmError, InvalidRequest
from cm.networks.bridge.records import FrameRecord
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.key_expressions import Attachment, EndKey
from cm.networks.rmw_zenoh.threads import Inbox, Workers
from cm.networks.ros.transport import Body, Values


class Copied:
    """The bytes of a frame that the library has copied already."""

    def __init__(self, data: memoryview) -> None:
        self._data, self.length = data, len(data)

    def into(self, target: npt.NDArray[np.uint8]) -> None:
        target[:] = np.frombuffer(self._data, np.uint8)


def hand_on(kind: str, message: bytes | memoryview, take: Callable[[dict[str, Any], Body], None]) -> None:
    """Pass a message's fields, and the bytes of its last one, to `take`.

    Raises InvalidRequest for what is no such message.
    """
    values, length, offset = cdr.decode_head(kind, message)
    data = memoryview(message)[offset : offset + length]
    if len(data) != length:
        raise InvalidRequest(f"{length} bytes are said to follow, {len(data)} do")
    take(values, Copied(data))


_HEARTBEAT = 0.5  # seconds, rmw_zenoh's


class ZenohPublisher:
    """A publisher; threads take turns. A frame is copied twice: into the message, and by zenoh's Python API."""

    def __init__(self, session: Any, end: EndKey) -> None:
        self._end = end
        self._gid = end.gid
        self._lock = threading.Lock()
        self._number = 0
        self._buffer = bytearray()  # used again for each frame
        self._plain = session.declare_publisher(end.key, **quality(end))
        self._put = (_latched(session, end) if end.quality.latched else self._plain).put
        self._token: Any = session.liveliness().declare_token(end.token)

    def write(self, values: Values) -> None:
        message = cdr.encode(self._end.kind, values)
        with self._lock:
            self._send(message)

    def write_frame(self, head: Values, frame: FrameRecord) -> None:
        start, data = cdr.head(self._end.kind, head, frame.data.nbytes), frame.data
        total = len(start) + data.nbytes
        with self._lock:  # one copy, whatever lies between the frame's rows
            if len(self._buffer) != total:
                self._buffer = bytearray(total)
            self._buffer[: len(start)] = start
            np.frombuffer(self._buffer, data.dtype, data.size, len(start)).reshape(data.shape)[...] = data
            self._send(self._buffer)

    def _send(self, message: bytes | bytearray) -> None:
        if self._token is not None:
            self._number += 1
            self._put(message, attachment=Attachment(self._number, time.time_ns(), self._gid).to_bytes())

    def listeners(self) -> int:
        with self._lock:
            return int(self._token is not None and self._plain.matching_status.matching)

    def close(self) -> None:
        with self._lock:
            token, self._token = self._token, None
            if token is None:
                return
            token.undeclare()
            self._put.__self__.undeclare()
            if self._end.quality.latched:
                self._plain.undeclare()


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


class ZenohSubscription:
    """`take` gets each message as it lies on the wire, in a thread of this subscription's own."""

    def __init__(self, session: Any, end: EndKey, take: Callable[[bytes], None]) -> None:
        self._inbox = Inbox(end.topic, end.quality.depth, lambda sample: take(sample.payload.to_bytes()))
        self._subscriber = session.declare_subscriber(end.key, zenoh.handlers.Callback(self._inbox.put, indirect=False))
        self._token: Any = session.liveliness().declare_token(end.token)

    def close(self) -> None:
        token, self._token = self._token, None
        if token is not None:
            token.undeclare()
            self._subscriber.undeclare()
            self._inbox.close()


_LOG = logging.getLogger("cm.rmw_zenoh")


class Service:
    """Answers requests."""

    def __init__(self, end: EndKey, answer: Callable[[dict[str, Any]], Values], workers: Workers) -> None:
        self._end = end
        self._answer = answer
        self._workers = workers

    def take(self, query: Any) -> None:
        """Take a request; if it is not a valid one, the reply says so."""
        try:
            attachment = Attachment.from_bytes(_bytes(query.attachment))
            values = cdr.decode(f"{self._end.kind}_Request", _bytes(query.payload))
        except InvalidRequest as error:
            with query:
                query.reply_err(f"{self._end.topic}: {error}")
            raise
        self._workers.start(self._end.topic, lambda: self._reply(query, attachment, values))

    def _reply(self, query: Any, asked: Attachment, values: dict[str, Any]) -> None:
        try:
            reply = cdr.encode(f"{self._end.kind}_Response", self._answer(values))
            self._workers.send(lambda: self._send(query, asked, reply))
        except (CmError, zenoh.ZError) as error:
            _LOG.warning("%s: %s", self._end.topic, error)

    def _send(self, query: Any, asked: Attachment, reply: bytes) -> None:
        attachment = Attachment(asked.number, time.time_ns(), asked.gid)
        with query:
            query.reply(self._end.key, reply, attachment=attachment.to_bytes())


def _bytes(payload: Any) -> bytes:
    return b"" if payload is None else bytes(payload.to_bytes())
