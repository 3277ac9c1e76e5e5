# SPDX-License-Identifier: Apache-2.0
"""Topics and services of a node as entities of Cyclone DDS, named and marked as ROS 2 has them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from cyclonedds.core import Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from cm.dds import config, frames, service
from cm.dds.dispatcher import Dispatcher
from cm.dds.graph import Graph
from cm.dds.library import Library
from cm.dds.publisher import DdsPublisher
from cm.dds.qos import qos
from cm.dds.types import sample_type
from cm.errors import InvalidRequest
from cm.ros import cdr
from cm.ros.node import NodeName
from cm.ros.transport import SERVICES, Body, Qos, Values
from cm.ros.typehash import type_hash
from cm.ros.workers import Workers

_REQUESTS = 32  # that are worked on at a time; others wait in their reader


class DdsTransport:
    """One participant with one node. Raises InvalidRequest where Cyclone DDS does not start."""

    def __init__(self, name: NodeName, domain: int, one_copy: bool = True) -> None:
        os.environ["CYCLONEDDS_URI"] = config.uri()  # the library takes settings in no other way
        try:
            self._participant = DomainParticipant(domain, qos=DdsQos(Policy.Userdata(b"enclave=/;")))
        except Exception as error:  # DDSException, or what its settings raise in the binding
            raise InvalidRequest(f"Cyclone DDS does not start in domain {domain}: {error}") from error
        self._library = Library.open() if one_copy else None
        self._graph = Graph(self._participant, name.name, name.namespace)
        self._requests = Dispatcher(self._participant, "services")
        self._workers = Workers(_REQUESTS)
        self._subscriptions: set[_Subscription] = set()
        self._publishers: set[DdsPublisher] = set()

    # ---- topics ---------------------------------------------------------------------------

    def publisher(self, topic: str, kind: str, quality: Qos) -> DdsPublisher:
        """Publish a topic."""
        writer = self._writer(f"rt{topic}", kind, qos(quality, type_hash(kind)))
        made = DdsPublisher(writer, kind, self._library, self._closed)
        self._publishers.add(made)
        self._graph.add(writers=(writer,))
        return made

    def _closed(self, publisher: DdsPublisher, writer: DataWriter) -> None:
        self._publishers.discard(publisher)
        self._graph.remove(writer)

    def subscription(
        self, topic: str, kind: str, quality: Qos, take: Callable[[dict[str, Any]], None]
    ) -> _Subscription:
        """Listen to a topic."""
        reader = self._reader(f"rt{topic}", kind, qos(quality, type_hash(kind)))
        self._graph.add(readers=(reader,))
        made = _Subscription(self, reader)
        made.dispatcher.add(reader, lambda sample: take(cdr.decode(kind, sample.data)))
        self._subscriptions.add(made)
        return made

    def frames(
        self, topic: str, kind: str, quality: Qos, take: Callable[[dict[str, Any], Body], None]
    ) -> _Subscription:
        """Listen to a topic of frames."""
        reader = self._reader(f"rt{topic}", kind, qos(quality, type_hash(kind)))
        self._graph.add(readers=(reader,))
        made = _Subscription(self, reader)
        made.dispatcher.watch(reader, frames.taking(self._library, reader, kind, take))
        self._subscriptions.add(made)
        return made

    # ---- services -------------------------------------------------------------------------

    def service(self, name: str, kind: str, answer: Callable[[dict[str, Any]], Values]) -> None:
        """Serve, for clients with rmw_cyclonedds."""
        asked, replied, mark = f"{kind}_Request", f"{kind}_Response", service.mark()
        writer = self._writer(f"rr{name}Reply", replied, qos(SERVICES, type_hash(replied), mark), service=True)
        reader = self._reader(f"rq{name}Request", asked, qos(SERVICES, type_hash(asked), mark), service=True)
        self._graph.add(readers=(reader,), writers=(writer,))
        replies = DdsPublisher(writer, replied, None, self._closed)
        self._publishers.add(replies)
        self._requests.add(reader, service.Service(kind, reader, replies, answer, self._workers).take)

    # ---- entities -------------------------------------------------------------------------

    def _writer(self, topic: str, kind: str, quality: DdsQos, service: bool = False) -> DataWriter:
        return DataWriter(self._participant, self._topic(topic, kind, service), qos=quality)

    def _reader(self, topic: str, kind: str, quality: DdsQos, service: bool = False) -> DataReader:
        return DataReader(self._participant, self._topic(topic, kind, service), qos=quality)

    def _topic(self, topic: str, kind: str, service: bool) -> Topic:
        return Topic(self._participant, topic, sample_type(kind, service))

    def gone(self, subscription: _Subscription, reader: DataReader) -> None:
        """A subscription has ended."""
        self._subscriptions.discard(subscription)
        self._graph.remove(reader)

    def close(self) -> None:
        """End all; twice is fine. Requests that wait get no answer."""
        self._workers.close()
        self._requests.close()
        for subscription in tuple(self._subscriptions):
            subscription.close()
        for publisher in tuple(self._publishers):
            publisher.close()
        self._participant.__del__()


class _Subscription:
    def __init__(self, owner: DdsTransport, reader: DataReader) -> None:
        self._owner = owner
        self._reader: DataReader | None = reader
        self.dispatcher = Dispatcher(owner._participant, "subscription")

    def close(self) -> None:
        """End it; twice is fine."""
        reader, self._reader = self._reader, None
        if reader is not None:
            self.dispatcher.close()
            self._owner.gone(self, reader)
            reader.__del__()
