# SPDX-License-Identifier: Apache-2.0
"""rmw_zenoh's names: keys of topics and services, tokens by which its graph knows nodes and their ends, attachments.

As its design document has them since Jazzy (0.2). Humble's keys have no hashes of types, and are others.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

import xxhash

from cm.errors import InvalidRequest
from cm.networks.rmw_zenoh.interfaces import dds_name
from cm.networks.ros.transport import Qos

GRAPH = "@ros2_lv"
_SLASH = "%"  # a name is one part of a token
_USUAL_DEPTH = 42  # rmw_zenoh's defaults are left out: reliable, volatile, this depth
_BEST_EFFORT, _TRANSIENT_LOCAL = "2", "1"  # rmw/types.h


class End(Enum):
    """The kind of an endpoint, as tokens spell it."""

    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


@dataclass(frozen=True, slots=True)
class NodeKey:
    """A node: `session` is zenoh's id of the session, `number` the node's within it."""

    domain: int
    session: str
    name: str
    namespace: str = "/"
    number: int = 0
    enclave: str = "/"

    @property
    def token(self) -> str:
        """The token by which others see the node."""
        return self.of(self.number, "NN")

    def of(self, number: int, kind: str) -> str:
        """The beginning of the tokens of its endpoints."""
        names = [_mangled(name) for name in (self.enclave, self.namespace, self.name)]
        return "/".join((GRAPH, str(self.domain), self.session, str(self.number), str(number), kind, *names))


@dataclass(frozen=True, slots=True)
class EndKey:
    """A publisher, subscription, service or client: `kind` and `hash_text` are those of its type, `topic` is whole."""

    node: NodeKey
    number: int
    end: End
    topic: str
    kind: str
    hash_text: str
    quality: Qos

    @property
    def key(self) -> str:
        """The key that its data is sent under."""
        return "/".join((str(self.node.domain), self.topic.strip("/"), dds_name(self.kind), self.hash_text))

    @property
    def token(self) -> str:
        """The token by which others see it."""
        start = self.node.of(self.number, self.end.value)
        return "/".join((start, _mangled(self.topic), dds_name(self.kind), self.hash_text, quality_text(self.quality)))

    @property
    def gid(self) -> bytes:
        """The 16 bytes by which ROS knows it: XXH3 of its token, the lower half first."""
        return xxhash.xxh3_128_digest(self.token.encode())[::-1]


def quality_text(quality: Qos) -> str:
    """Reliability, durability, history and depth, deadline, lifespan, liveliness."""
    reliability = "" if quality.reliable else _BEST_EFFORT
    durability = _TRANSIENT_LOCAL if quality.latched else ""
    depth = "" if quality.depth == _USUAL_DEPTH else quality.depth
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def _mangled(name: str) -> str:
    return name.replace("/", _SLASH)


_LAYOUT = struct.Struct("<qqB16s")  # as zenoh's serializer writes two integers and an array with its length before it
_GID = 16


@dataclass(frozen=True, slots=True)
class Attachment:
    """`number` counts from 1 for each sender; `stamp_ns` is wall time; `gid` are its sender's 16 bytes."""

    number: int
    stamp_ns: int
    gid: bytes

    def to_bytes(self) -> bytes:
        """As it lies on the wire."""
        return _LAYOUT.pack(self.number, self.stamp_ns, _GID, self.gid)

    @classmethod
    def from_bytes(cls, data: bytes) -> Attachment:
        """Raises InvalidRequest for what is no attachment."""
        if len(data) != _LAYOUT.size or data[16] != _GID:
            raise InvalidRequest(
                f"this is not an attachment of rmw_zenoh since Jazzy: {data[:40].hex(' ') or 'nothing'}"
            )
        number, stamp_ns, _, gid = _LAYOUT.unpack(data)
        return cls(number, stamp_ns, gid)
