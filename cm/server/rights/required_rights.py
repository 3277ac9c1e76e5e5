# SPDX-License-Identifier: Apache-2.0
"""The right that each request takes, and each purpose for which a connection to the data socket is opened. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from cm.frozen import replace
from cm.manager import touched
from cm.manager.touched import Scene, Thing
from cm.server.rights.model import Need, Role
from cm.wire.messages import requests as rq
from cm.wire.plane_packets import Purpose

_READ_CONFIG, _WRITE_CONFIG, _DATA_CONFIG, _DATA = "cm_read_config", "cm_write_config", "cm_data_config", "data"


class Right(NamedTuple):
    """The least role that it takes, under which topic; and where, which is asked for who has the role with limits."""

    least: Need
    touches: Callable[[Any, Scene], Iterable[Thing]]


UNKNOWN = Right(Need(Role.ADMIN, ""), touched.nothing)  # of a request that has no row


def needs_of(right: Right, request: Any, scene: Scene) -> Iterator[Need]:
    """The right to everything that a request touches."""
    role, topic = right.least.role, right.least.topic
    return (Need(role, topic, *thing) for thing in right.touches(request, scene))


def provisioning(name: str) -> Need:
    """The right to store a configuration, asked when its schema has been read and its name is known."""
    return replace(RIGHTS[rq.Provision].least, config=name)


def _right(role: Role, topic: str, touches: Callable[[Any, Scene], Iterable[Thing]]) -> Right:
    return Right(Need(role, topic), touches)


RIGHTS: Mapping[type | Purpose, Right] = MappingProxyType(
    {
        rq.ReadStatus: _right(Role.OBSERVE, "cm_status", touched.nothing),
        rq.ReadConfig: _right(Role.OBSERVE, _READ_CONFIG, touched.named_config),
        rq.ListConfigs: _right(Role.OBSERVE, _READ_CONFIG, touched.nothing),
        rq.PlanChange: _right(Role.OBSERVE, _READ_CONFIG, touched.named_config),
        rq.ChangeMode: _right(Role.OPERATE, _WRITE_CONFIG, touched.change),
        rq.CancelChange: _right(Role.OPERATE, _WRITE_CONFIG, touched.running_change),
        rq.Provision: _right(Role.PROVISION, _WRITE_CONFIG, touched.nothing),  # see `provisioning`
        rq.RemoveConfig: _right(Role.PROVISION, _WRITE_CONFIG, touched.named_config),
        rq.ReadReg: _right(Role.OBSERVE, "cm_read_reg", touched.registers),
        rq.WriteReg: _right(Role.OPERATE, "cm_write_reg", touched.registers),
        rq.DescribeData: _right(Role.OBSERVE, _DATA_CONFIG, touched.data),
        rq.ConfigureStream: _right(Role.OPERATE, _DATA_CONFIG, touched.data),
        rq.DefineMemory: _right(Role.PROVISION, _DATA_CONFIG, touched.defined_memory),
        rq.ReadData: _right(Role.OBSERVE, "cm_read_data", touched.data),
        rq.WriteData: _right(Role.OPERATE, "cm_write_data", touched.data),
        rq.Upload: _right(Role.OPERATE, "cm_upload", touched.nothing),
        rq.CheckRegion: _right(Role.OPERATE, "cm_region", touched.region),
        rq.MapRegion: _right(Role.OBSERVE, "cm_region", touched.region),
        rq.ReadIrq: _right(Role.OBSERVE, "cm_irq", touched.nothing),
        rq.TakeLease: _right(Role.OPERATE, "cm_lease", touched.lease),
        rq.RenewLease: _right(Role.OPERATE, "cm_lease", touched.nothing),
        rq.BreakLease: _right(Role.ADMIN, "cm_lease", touched.nothing),
        rq.ReleaseLease: _right(Role.OPERATE, "cm_lease", touched.nothing),
        Purpose.READ: _right(Role.OBSERVE, _DATA, touched.opened_stream),
        Purpose.WRITE: _right(Role.OPERATE, _DATA, touched.opened_stream),
        Purpose.ECHO: _right(Role.OBSERVE, _DATA, touched.opened_memory),
        Purpose.ALLOCATE: _right(Role.OPERATE, _DATA, touched.opened_memory),
        Purpose.WINDOW: _right(Role.MAP, _DATA, touched.opened_window),
        Purpose.WRITABLE_WINDOW: _right(Role.MAP, _DATA, touched.opened_window),
        Purpose.REGISTERS: _right(Role.OBSERVE, touched.ALL, touched.everything),  # nobody looks at each read
    }
)
