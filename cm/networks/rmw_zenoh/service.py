# SPDX-License-Identifier: Apache-2.0
"""A service: a queryable whose queries carry a request, and whose replies return the attachment's number."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

import zenoh

from cm.errors import CmError, InvalidRequest
from cm.networks.rmw_zenoh.attachment import Attachment
from cm.networks.rmw_zenoh.keys import EndKey
from cm.networks.ros import cdr
from cm.networks.ros.transport import Values
from cm.networks.ros.workers import Workers

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
