# SPDX-License-Identifier: Apache-2.0
"""What a right is, and which one each purpose takes for which a connection to the data socket is opened. Pure.

`cm.server.requests` has those of requests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from cm.manager import touched
from cm.manager.touched import Scene, Thing
from cm.server.rights.model import Need, Role
from cm.wire.plane_packets import Purpose

_DATA = "data"


class Right(NamedTuple):
    """The least role that it takes, under which topic; and where, which is asked for who has the role with limits."""

    least: Need
    touches: Callable[[Any, Scene], Iterable[Thing]]


def needs_of(right: Right, request: Any, scene: Scene) -> Iterator[Need]:
    """The right to everything that a request touches."""
    role, topic = right.least.role, right.least.topic
    return (Need(role, topic, *thing) for thing in right.touches(request, scene))


def provisioning(name: str) -> Need:
    """The right to store a configuration, asked when its schema has been read and its name is known."""
    return Need(Role.PROVISION, "cm_write_config", name)


def _right(role: Role, topic: str, touches: Callable[[Any, Scene], Iterable[Thing]]) -> Right:
    return Right(Need(role, topic), touches)


OPENING: Mapping[Purpose, Right] = MappingProxyType(
    {
        Purpose.READ: _right(Role.OBSERVE, _DATA, touched.opened_stream),
        Purpose.WRITE: _right(Role.OPERATE, _DATA, touched.opened_stream),
        Purpose.TRANSFER: _right(Role.OPERATE, _DATA, touched.opened_stream),
        Purpose.ECHO: _right(Role.OBSERVE, _DATA, touched.opened_memory),
        Purpose.ALLOCATE: _right(Role.OPERATE, _DATA, touched.opened_memory),
        Purpose.WINDOW: _right(Role.MAP, _DATA, touched.opened_window),
        Purpose.WRITABLE_WINDOW: _right(Role.MAP, _DATA, touched.opened_window),
        Purpose.REGISTERS: _right(Role.OBSERVE, touched.ALL, touched.everything),  # nobody looks at each read
    }
)
