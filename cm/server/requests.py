# SPDX-License-Identifier: Apache-2.0
"""Every request, a row each: what it waits for, what others wait for meanwhile, and what it does.

`cm.wire.request_table` says how each travels, `cm.server.rights.required_rights` who may make it.
"""

from __future__ import annotations

from collections.abc import Iterator

from cm.errors import CmError
from cm.manager.access.register_service import AT_ONCE
from cm.manager.manager import Manager
from cm.schema.model import Memory
from cm.server import request_handlers as handlers
from cm.server.sender_order import Holds, Row, Waits
from cm.wire.messages import requests as rq


def _many_registers(request: rq.ReadReg | rq.WriteReg, manager: Manager) -> Holds | None:
    named = request.writes if isinstance(request, rq.WriteReg) else request.names or manager.registers.visible_names()
    return Holds.LONG if len(named) > AT_ONCE else None


def _stores(_: rq.Provision | rq.RemoveConfig, __: Manager) -> Holds | None:
    return Holds.STORES


def _writes_memory(request: rq.WriteData, manager: Manager) -> Holds | None:
    return Holds.WRITES if _memory(request.stream, manager) else None


def _is_memory(request: rq.WriteData, manager: Manager) -> bool:
    return _memory(request.stream, manager) is not None


def _always(_: rq.WriteReg, __: Manager) -> bool:
    return True


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


NEVER, IN_LINE, TO_WRITE, TO_CHANGE = Waits
ROWS = (
    Row(rq.ReadStatus, handlers.read_status, NEVER),
    Row(rq.ReadConfig, handlers.read_config, NEVER),
    Row(rq.ListConfigs, handlers.list_configs, NEVER),
    Row(rq.PlanChange, handlers.plan_change, NEVER, counted=True),
    Row(rq.ChangeMode, handlers.change_mode, TO_CHANGE, counted=True),
    Row(rq.CancelChange, handlers.cancel_change, NEVER),
    Row(rq.Provision, handlers.provision, TO_CHANGE, holds=_stores, counted=True, uploads=True),
    Row(rq.RemoveConfig, handlers.remove_config, TO_CHANGE, holds=_stores, counted=True),
    Row(rq.ReadReg, handlers.read_reg, IN_LINE, holds=_many_registers),
    Row(rq.WriteReg, handlers.write_reg, TO_WRITE, holds=_many_registers, writes=_registers, behind_memory=_always),
    Row(rq.DescribeData, handlers.describe_data, IN_LINE),
    Row(rq.ConfigureStream, handlers.configure_stream, TO_WRITE, writes=_data),
    Row(rq.DefineMemory, handlers.define_memory, TO_WRITE),
    Row(rq.ReadData, handlers.read_data, IN_LINE, counted=True),
    Row(
        rq.WriteData, handlers.write_data, TO_WRITE, holds=_writes_memory, writes=_data, behind_memory=_is_memory,
        counted=True, uploads=True,
    ),
    Row(rq.Upload, handlers.upload, IN_LINE),
    Row(rq.CheckRegion, handlers.check_region, IN_LINE),
    Row(rq.MapRegion, handlers.map_region, IN_LINE),
    Row(rq.ReadIrq, handlers.read_irq, NEVER),
    Row(rq.TakeLease, handlers.take_lease, IN_LINE),
    Row(rq.RenewLease, handlers.lease, IN_LINE),
    Row(rq.ReleaseLease, handlers.lease, IN_LINE),
    Row(rq.BreakLease, handlers.lease, IN_LINE),
)  # fmt: skip
BY_KIND = {row.kind: row for row in ROWS}
