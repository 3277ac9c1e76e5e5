# SPDX-License-Identifier: Apache-2.0
"""A service: a queryable whose queries carry a request, and whose replies return the attachment's number."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

from cm.errors import CmError, InvalidRequest
from cm.rmw_zenoh.attachment import Attachment
from cm.rmw_zenoh.keys import EndKey
from cm.ros import cdr
from cm.ros.transport import Values

_LOG = logging.getLogger("cm.rmw_zenoh")
_LOOK = 0.1  # seconds between two checks for the end, while as many requests run as are allowed


class Door:
    """Lets one thread at a time into zenoh, and none once it is closed.

    A thread that is inside zenoh's library when the interpreter ends aborts the whole process.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.closed = False

    def enter(self, work: Callable[[], None]) -> None:
        """Do `work` inside, unless it is closed."""
        with self._lock:
            if not self.closed:
                work()

    def close(self) -> None:
        """Let no thread in any more, and wait for the one that is inside; twice is fine."""
        with self._lock:
            self.closed = True


class Service:
    """Answers requests, each in a thread of its own, `busy` of them at a time."""

    def __init__(
        self, end: EndKey, answer: Callable[[dict[str, Any]], Values], busy: threading.Semaphore, door: Door
    ) -> None:
        self._end = end
        self._answer = answer
        self._busy = busy
        self._door = door

    def take(self, query: Any) -> None:
        """Take a request; if it is not a valid one, the reply says so."""
        try:
            attachment = Attachment.from_bytes(_bytes(query.attachment))
            values = cdr.decode(f"{self._end.kind}_Request", _bytes(query.payload))
        except InvalidRequest as error:
            with query:
                query.reply_err(f"{self._end.topic}: {error}")
            raise
        while not self._busy.acquire(timeout=_LOOK):
            if self._door.closed:
                return
        arguments = (query, attachment, values)
        threading.Thread(target=self._reply, args=arguments, name=self._end.topic, daemon=True).start()

    def _reply(self, query: Any, asked: Attachment, values: dict[str, Any]) -> None:
        try:
            reply = cdr.encode(f"{self._end.kind}_Response", self._answer(values))
            self._door.enter(lambda: self._send(query, asked, reply))
        except (CmError, zenoh.ZError) as error:
            _LOG.warning("%s: %s", self._end.topic, error)
        finally:
            self._busy.release()

    def _send(self, query: Any, asked: Attachment, reply: bytes) -> None:
        attachment = Attachment(asked.number, time.time_ns(), asked.gid)
        with query:
            query.reply(self._end.key, reply, attachment=attachment.to_bytes())


def _bytes(payload: Any) -> bytes:
    return b"" if payload is None else bytes(payload.to_bytes())
