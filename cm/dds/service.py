# SPDX-License-Identifier: Apache-2.0
"""A service as in rmw_cyclonedds: two plain topics, with client and request number before request and reply."""

from __future__ import annotations

import logging
import os
import struct
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.core import DDSException, Policy
from cyclonedds.sub import DataReader

from cm.dds.publisher import DdsPublisher
from cm.dds.types import Raw
from cm.errors import CmError
from cm.ros import cdr
from cm.ros.transport import Values
from cm.ros.workers import Workers

_LOG = logging.getLogger("cm.dds")
_HEADER = struct.Struct("<Qq")
_MET = 10.0  # seconds that a reply waits for DDS to find the reader of the client that asked; without, it would be lost
_LOOK = 0.005
_CLIENT = b"clientid="


def mark() -> str:
    """The mark by which the two ends of a service belong together."""
    return "serviceid=" + ".".join(f"{byte:x}" for byte in os.urandom(16)) + ";"


class Service:
    """Answers requests."""

    def __init__(
        self,
        kind: str,
        requests: DataReader,
        replies: DdsPublisher,
        answer: Callable[[dict[str, Any]], Values],
        workers: Workers,
    ) -> None:
        self._asked, self._replied = f"{kind}_Request", f"{kind}_Response"
        self._requests, self._replies = requests, replies
        self._answer = answer
        self._workers = workers

    def take(self, sample: Raw) -> None:
        """Take a request. Raises InvalidRequest for what is not one."""
        request = cdr.Reader(sample.data)
        header = _HEADER.pack(request.take("Q", 8), request.take("q", 8))
        values = cdr.read(self._asked, request)
        client = sample.sample_info.publication_handle
        self._workers.start(self._asked, lambda: self._reply(header, values, client))

    def _reply(self, header: bytes, values: dict[str, Any], client: int) -> None:
        try:
            sample = bytearray(cdr.HEADER) + header
            cdr.put(self._replied, sample, self._answer(values))
            if self._is_met(client):
                self._replies.write_bytes(sample)
        except (CmError, DDSException) as error:
            if not self._workers.closed:  # ends that were closed meanwhile
                _LOG.warning("%s: %s", self._asked, error)

    def _is_met(self, client: int) -> bool:
        """Whether a reply would reach the client: its writer may be known before its reader. False if it has gone."""
        until = time.monotonic() + _MET
        while not self._workers.closed and (asking := self._requests.get_matched_publication_data(client)) is not None:
            name = _client_of(asking)
            if not name or name in self._listening():
                return True
            if time.monotonic() > until:
                _LOG.warning("%s: DDS does not find the reader of the client that asked", self._asked)
                return False
            time.sleep(_LOOK)
        return False

    def _listening(self) -> set[bytes]:
        writer = self._replies.writer
        if writer is None:
            return set()
        ends = (writer.get_matched_subscription_data(handle) for handle in writer.get_matched_subscriptions())
        return {_client_of(end) for end in ends if end is not None}


def _client_of(end: Any) -> bytes:
    """The mark of a client's endpoint; empty for old clients, which have none."""
    data = end.qos[Policy.Userdata].data if Policy.Userdata in end.qos else b""
    found = next((part for part in data.split(b";") if part.startswith(_CLIENT)), b"")
    return bytes(found)
