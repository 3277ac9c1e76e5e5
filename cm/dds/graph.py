# SPDX-License-Identifier: Apache-2.0
"""What makes a participant a ROS node: its endpoints on ``ros_discovery_info``, as since ROS 2 Iron."""

from __future__ import annotations

import threading
from typing import Any

from cyclonedds._clayer import ddspy_write
from cyclonedds.core import Entity
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

from cm.dds.qos import qos
from cm.dds.types import sample_type
from cm.ros import cdr
from cm.ros.transport import LATCHED
from cm.ros.typehash import type_hash

_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"


class Graph:
    """The one node of a participant, and its endpoints."""

    def __init__(self, participant: DomainParticipant, name: str, namespace: str) -> None:
        self._lock = threading.Lock()
        self._gid = gid(participant)
        self._node = {"node_name": name, "node_namespace": namespace}
        self._ends: dict[str, list[bytes]] = {"reader_gid_seq": [], "writer_gid_seq": []}
        topic = Topic(participant, "ros_discovery_info", sample_type(_TYPE))
        self._writer = DataWriter(participant, topic, qos=qos(LATCHED, type_hash(_TYPE)))

    def add(self, *, readers: tuple[Entity, ...] = (), writers: tuple[Entity, ...] = ()) -> None:
        """More endpoints."""
        with self._lock:
            self._ends["reader_gid_seq"] += [gid(end) for end in readers]
            self._ends["writer_gid_seq"] += [gid(end) for end in writers]
            self._tell()

    def remove(self, *ends: Entity) -> None:
        """Endpoints that are about to be closed."""
        gone = {gid(end) for end in ends}
        with self._lock:
            self._ends = {key: [kept for kept in held if kept not in gone] for key, held in self._ends.items()}
            self._tell()

    def _tell(self) -> None:
        ends = {key: [{"data": number} for number in held] for key, held in self._ends.items()}
        node: dict[str, Any] = {**self._node, **ends}
        sample = cdr.encode(_TYPE, {"gid": {"data": self._gid}, "node_entities_info_seq": [node]})
        ddspy_write(self._writer._ref, sample.ljust(len(sample) + -len(sample) % 4, b"\0"))


def gid(entity: Entity) -> bytes:
    """The GUID by which others know an entity."""
    return bytes(entity.guid.bytes)
