# SPDX-License-Identifier: Apache-2.0
"""`cm.networks.ros.transport` over rclpy."""

from __future__ import annotations

import array
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from cm.networks.bridge.records import FrameRecord
from cm.networks.ros.transport import Body, Qos, Values
from cm_ros2.conversion import fill, interface, values


class RclpyTransport:
    """Topics and services of a node. Its executor must have several threads: a change of mode takes its time."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._group = ReentrantCallbackGroup()
        self._services: list[Any] = []
        self._publishers: set[RclpyPublisher] = set()

    def publisher(self, topic: str, kind: str, quality: Qos) -> RclpyPublisher:
        """Publish a topic."""
        made = RclpyPublisher(self._node, interface(kind), topic, _profile(quality))
        self._publishers.add(made)
        return made

    def frames(
        self, topic: str, kind: str, quality: Qos, take: Callable[[dict[str, Any], Body], None]
    ) -> RclpySubscription:
        """Listen to a topic of frames."""

        def handed(message: Any) -> None:
            found = values(message)
            take(found, _Bytes(found.pop("data")))

        return RclpySubscription(self._node, interface(kind), topic, _profile(quality), handed)

    def service(self, name: str, kind: str, answer: Callable[[dict[str, Any]], Values]) -> RclpyService:
        """Serve."""
        service = self._node.create_service(
            interface(kind),
            name,
            lambda request, response: fill(response, answer(values(request))),
            callback_group=self._group,
        )
        self._services.append(service)
        return RclpyService(self._node, service)

    def close(self) -> None:
        """End all; twice is fine."""
        while self._services:
            self._node.destroy_service(self._services.pop())
        while self._publishers:
            self._publishers.pop().close()


class RclpyPublisher:
    """A topic that is published."""

    def __init__(self, node: Node, kind: Any, topic: str, profile: QoSProfile) -> None:
        self._node = node
        self._kind = kind
        self._publisher = node.create_publisher(kind, topic, profile)

    def write(self, message: Values) -> None:
        """One message."""
        if self._publisher is not None:
            self._publisher.publish(fill(self._kind(), message))

    def write_frame(self, head: Values, frame: FrameRecord) -> None:
        """A frame as the field ``data``; an array of bytes is taken over as it is, all else byte by byte."""
        if self._publisher is not None:
            message = fill(self._kind(), head)
            data = array.array("B")
            data.frombytes(memoryview(np.ascontiguousarray(frame.data)).cast("B"))
            message.data = data
            self._publisher.publish(message)

    def listeners(self) -> int:
        """How many subscribers there are."""
        return 0 if self._publisher is None else int(self._publisher.get_subscription_count())

    def close(self) -> None:
        """End it; twice is fine."""
        publisher, self._publisher = self._publisher, None
        if publisher is not None:
            self._node.destroy_publisher(publisher)


class _Bytes:
    """A frame's bytes in its message."""

    def __init__(self, data: memoryview) -> None:
        self._data, self.length = data, len(data)

    def into(self, target: np.ndarray[Any, np.dtype[np.uint8]]) -> None:
        """Copy them all."""
        target[:] = np.frombuffer(self._data, np.uint8)


class RclpySubscription:
    """A topic that is listened to."""

    def __init__(self, node: Node, kind: Any, topic: str, profile: QoSProfile, take: Callable[[Any], None]) -> None:
        self._node = node
        self._subscription = node.create_subscription(kind, topic, take, profile)

    def close(self) -> None:
        """End it; twice is fine."""
        subscription, self._subscription = self._subscription, None
        if subscription is not None:
            self._node.destroy_subscription(subscription)


class RclpyService:
    """A service that is served."""

    def __init__(self, node: Node, service: Any) -> None:
        self._node = node
        self._service = service

    def close(self) -> None:
        """End it; twice is fine."""
        service, self._service = self._service, None
        if service is not None:
            self._node.destroy_service(service)


def _profile(quality: Qos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=quality.depth,
        reliability=ReliabilityPolicy.RELIABLE if quality.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if quality.latched else DurabilityPolicy.VOLATILE,
    )
