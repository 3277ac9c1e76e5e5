# SPDX-License-Identifier: Apache-2.0
"""Every request, a row each: its handler, who may make it, what it waits for, and what others wait for meanwhile.

`cm.wire.request_table` says how each travels. Right and order have no defaults: a row that forgot one would look right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from cm.errors import CmError
from cm.manager import touched
from cm.manager.manager import Manager
from cm.manager.touched import Scene, Thing
from cm.schema.model import Memory
from cm.server import request_handlers as do
from cm.server.rights.model import Need, Role
from cm.server.rights.required_rights import Right
from cm.server.sender_order import Row, Waits
from cm.wire.messages import requests as rq
from cm.wire.request_table import BY_KIND as ON_THE_WIRE


def _memory(name: str, manager: Manager) -> Memory | None:
    try:
        return manager.memories.find(name)
    except CmError:  # a name of another mode, or nothing is loaded: its handler says so
        return None


def _registers(request: rq.WriteReg, manager: Manager) -> Iterator[str]:
    config = manager.loaded_config()
    visible = config.visible_registers(manager.state.mode) if config else {}
    for name in {write.name.partition(".")[0] for write in request.writes}:
        yield f"registers:{name}"
        yield f"region:{visible[name].region if name in visible else None}"


def _data(request: rq.WriteData | rq.ConfigureStream, manager: Manager) -> Iterator[str]:
    config = manager.loaded_config()
    what = _memory(request.stream, manager) or (config.streams.get(request.stream) if config else None)
    yield f"memories:{request.stream}"
    yield f"region:{what.region if what else None}"


def _row(
    kind: type, handler: Any, role: Role, touches: Callable[[Any, Scene], Iterable[Thing]], waits: Waits, **more: Any
) -> Row:
    """`role` and `touches`: the least role that it takes, and where, for who has the role with limits."""
    return Row(kind, handler, Right(Need(role, ON_THE_WIRE[kind].topic.decode()), touches), waits, **more)


OBSERVE, OPERATE, PROVISION, ADMIN = Role.OBSERVE, Role.OPERATE, Role.PROVISION, Role.ADMIN
NEVER, IN_LINE, TO_WRITE, TO_CHANGE = Waits
ROWS = (
    _row(rq.ReadStatus, do.read_status, OBSERVE, touched.nothing, NEVER),
    _row(rq.ReadConfig, do.read_config, OBSERVE, touched.named_config, NEVER),
    _row(rq.ListConfigs, do.list_configs, OBSERVE, touched.nothing, NEVER),
    _row(rq.PlanChange, do.plan_change, OBSERVE, touched.named_config, NEVER, counted=True),
    _row(rq.ChangeMode, do.change_mode, OPERATE, touched.change, TO_CHANGE, counted=True),
    _row(rq.CancelChange, do.cancel_change, OPERATE, touched.running_change, NEVER),
    # What it touches is asked for when its schema has been read: `provisioning`.
    _row(rq.Provision, do.provision, PROVISION, touched.nothing, TO_CHANGE, counted=True, uploads=True),
    _row(rq.RemoveConfig, do.remove_config, PROVISION, touched.named_config, TO_CHANGE, counted=True),
    _row(rq.ReadReg, do.read_reg, OBSERVE, touched.registers, IN_LINE),
    _row(
        rq.WriteReg, do.write_reg, OPERATE, touched.registers, TO_WRITE,
        writes=_registers, behind_memory=lambda *_: True,
    ),
    _row(rq.DescribeData, do.describe_data, OBSERVE, touched.data, IN_LINE),
    _row(rq.ConfigureStream, do.configure_stream, OPERATE, touched.data, TO_WRITE, writes=_data),
    _row(rq.DefineMemory, do.define_memory, PROVISION, touched.defined_memory, TO_WRITE),
    _row(rq.ReadData, do.read_data, OBSERVE, touched.data, IN_LINE, counted=True),
    _row(
        rq.WriteData, do.write_data, OPERATE, touched.data, TO_WRITE,
        writes=_data, behind_memory=lambda r, m: _memory(r.stream, m) is not None, counted=True, uploads=True,
    ),
    _row(rq.Upload, do.upload, OPERATE, touched.nothing, IN_LINE),
    _row(rq.CheckRegion, do.check_region, OPERATE, touched.region, IN_LINE),
    _row(rq.MapRegion, do.map_region, OBSERVE, touched.region, IN_LINE),
    _row(rq.ReadIrq, do.read_irq, OBSERVE, touched.nothing, NEVER),
    _row(rq.TakeLease, do.take_lease, OPERATE, touched.lease, IN_LINE),
    _row(rq.RenewLease, do.lease, OPERATE, touched.nothing, IN_LINE),
    _row(rq.ReleaseLease, do.lease, OPERATE, touched.nothing, IN_LINE),
    _row(rq.BreakLease, do.lease, ADMIN, touched.nothing, IN_LINE),
)  # fmt: skip
BY_KIND = {row.kind: row for row in ROWS}
