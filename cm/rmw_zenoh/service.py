# SPDX-License-Identifier: Apache-2.0
"""A service: a queryable, whose queries bring a request and whose replies give back the attachment's number."""

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


class Service:
    """Answers requests, each in a thread of its own, `busy` of them at a time."""

    def __init__(self, end: EndKey, answer: Callable[[dict[str, Any]], Values], busy: threading.Semaphore) -> None:
        self._end = end
        self._answer = answer
        self._busy = busy

    def take(self, query: Any) -> None:
        """A request; what is none is told to who asked."""
        try:
            attachment = Attachment.from_bytes(_bytes(query.attachment))
            values = cdr.decode(f"{self._end.kind}_Request", _bytes(query.payload))
        except InvalidRequest as error:
            with query:
                query.reply_err(f"{self._end.topic}: {error}")
            raise
        self._busy.acquire()
        arguments = (query, attachment, values)
        threading.Thread(target=self._reply, args=arguments, name=self._end.topic, daemon=True).start()

    def _reply(self, query: Any, asked: Attachment, values: dict[str, Any]) -> None:
        try:
            with query:
                reply = cdr.encode(f"{self._end.kind}_Response", self._answer(values))
                attachment = Attachment(asked.number, time.time_ns(), asked.gid)
                query.reply(self._end.key, reply, attachment=attachment.to_bytes())
        except (CmError, zenoh.ZError) as error:  # also of a session that was closed meanwhile
            _LOG.warning("%s: %s", self._end.topic, error)
        finally:
            self._busy.release()


def _bytes(payload: Any) -> bytes:
    return b"" if payload is None else bytes(payload.to_bytes())
