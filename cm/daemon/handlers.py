# SPDX-License-Identifier: Apache-2.0
"""One handler per kind of request: from a frozen request to calls of manager and streams, and a reply."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from cm.daemon.host.provision import Provisioner
from cm.daemon.interrupts import Interrupts
from cm.daemon.loop import Loop
from cm.daemon.memory_transfers import Memories, frame_info
from cm.daemon.streams.registry import Streams
from cm.daemon.streams.stream import Frame
from cm.device import DeviceGone
from cm.errors import CmError
from cm.manager.access.memory_service import Transfer
from cm.manager.errors import UnknownInterrupt, UnknownStream
from cm.manager.execution.worker import Change
from cm.manager.manager import Manager
from cm.manager.planning.resolve import hint
from cm.messages import requests as rq
from cm.messages.status import (
    Body,
    ChangeInfo,
    ConfigInfo,
    ErrorInfo,
    LeaseInfo,
    RegValues,
    Reply,
    Status,
    StreamStatus,
)
from cm.schema.model import Config

_LOG = logging.getLogger(__name__)
Respond = Callable[[Reply], None]
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Services:
    """What the handlers work with."""

    loop: Loop
    manager: Manager
    streams: Streams
    interrupts: Interrupts
    provisioner: Provisioner
    status: Callable[[], Status]
    watch_holder: Callable[[LeaseInfo, rq.TakeLease], None]
    complete: Callable[[Config], Config]  # adds what only the board knows
    aside: Executor  # for what reads or writes files, so that the loop goes on
    memories: Memories


def error_info(error: Exception) -> ErrorInfo:
    """An exception as it travels; what is not ours is a device's or a defect."""
    if isinstance(error, CmError):
        return ErrorInfo(error.code, str(error))
    if isinstance(error, OSError):
        return ErrorInfo("device_error", str(error))
    return ErrorInfo("internal", f"{type(error).__name__}: {error}")


class Handlers:
    """Dispatches requests. `respond` is called exactly once, now or later, in the loop's thread."""

    def __init__(self, services: Services) -> None:
        self._s = services
        self._table: dict[type, Callable[..., None]] = {
            rq.ReadStatus: self._read_status,
            rq.ReadConfig: self._read_config,
            rq.WriteConfig: self._write_config,
            rq.ReadReg: self._read_reg,
            rq.WriteReg: self._write_reg,
            rq.DataConfig: self._data_config,
            rq.ReadData: self._read_data,
            rq.WriteData: self._write_data,
            rq.ReadIrq: self._read_irq,
            rq.TakeLease: self._lease,
        }

    def handle(self, request: rq.Request, respond: Respond) -> None:
        """Do what a request asks; whatever goes wrong becomes an error reply."""
        try:
            self._table[type(request)](request, respond)
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            self.refuse(error, respond)

    def refuse(self, error: Exception, respond: Respond) -> None:
        """Tell who asked what went wrong."""
        if isinstance(error, DeviceGone):
            self._s.manager.board_lost(error)
        if isinstance(error, UnknownStream):
            error = UnknownStream(f"{error}{self._s.manager.memories.listed()}")  # one may have been meant
        if not isinstance(error, (CmError, OSError)):
            _LOG.error("a request failed", exc_info=error)
        respond(Reply(error=error_info(error)))

    def _aside(self, work: Callable[[], _T], then: Callable[[_T], None], respond: Respond) -> None:
        """Do `work` in another thread and go on with `then` in the loop's."""

        def finish(call: Callable[[], None]) -> None:
            try:
                call()
            except Exception as error:  # noqa: BLE001 (every request gets an answer)
                self.refuse(error, respond)

        def run() -> None:
            try:
                result = work()
            except Exception as error:  # noqa: BLE001 (handed to the loop)
                self._s.loop.call_threadsafe(partial(self.refuse, error, respond))
            else:
                self._s.loop.call_threadsafe(partial(finish, lambda: then(result)))

        self._s.aside.submit(run)

    def _read_status(self, _: rq.ReadStatus, respond: Respond) -> None:
        respond(Reply(self._s.status()))

    def _read_config(self, request: rq.ReadConfig, respond: Respond) -> None:
        body: Body
        if request.list_names:
            body = ConfigInfo(names=tuple(sorted(self._s.manager.configs)))
        elif request.plan:
            wanted = rq.WriteConfig(config_name=request.config_name, mode=request.plan_mode)
            self._aside(lambda: self._s.manager.plan(wanted), lambda plan: respond(Reply(plan)), respond)
            return
        else:
            info = self._s.manager.describe(request.config_name, self._s.interrupts.counts)
            body = self._s.memories.described(info)
        respond(Reply(body))

    def _write_config(self, request: rq.WriteConfig, respond: Respond) -> None:
        if request.cancel:
            self._s.manager.cancel()
            respond(Reply(self._s.status()))
            return
        if request.schema:
            self._s.manager.leases.check(("config",), request.lease)
            allowed = self._s.manager.check_replaceable
            store = partial(self._s.provisioner.store, request.schema, request.files, allowed)
            self._aside(store, lambda config: self._provisioned(request, config, respond), respond)
            return
        self._change(request, respond)

    def _provisioned(self, request: rq.WriteConfig, config: Config, respond: Respond) -> None:
        self._s.manager.add_config(self._s.complete(config))
        if request.provision_only:
            respond(Reply(self._s.manager.describe(config.name, {})))
            return
        self._change(replace(request, config_name=config.name, schema="", files=()), respond)

    def _change(self, request: rq.WriteConfig, respond: Respond) -> None:
        if request.no_wait:
            change = self._s.manager.submit(request)
            respond(Reply(ChangeInfo(change.number, done=False)))
            return
        self._s.manager.submit(request, lambda c: self._s.loop.call_threadsafe(lambda: respond(_ended(c))))

    def _read_reg(self, request: rq.ReadReg, respond: Respond) -> None:
        respond(Reply(self._s.manager.registers.read(request.names)))

    def _write_reg(self, request: rq.WriteReg, respond: Respond) -> None:
        values: RegValues = self._s.manager.write_registers(request.writes, request.lease)
        respond(Reply(values))

    def _data_config(self, request: rq.DataConfig, respond: Respond) -> None:
        memory = self._s.memories.configure(request)
        if memory is not None:
            respond(Reply(memory))
            return
        stream = self._s.streams.named(request.stream, None)
        self._s.streams.check_lease(stream, request.lease)
        result: StreamStatus = self._s.streams.configure(request)
        respond(Reply(result))

    def _read_data(self, request: rq.ReadData, respond: Respond) -> None:
        desk = self._s.manager.memories
        if request.offset or request.length or desk.find(request.stream):
            self._transfer(desk.begin_read(request.stream, request.offset, request.length), respond)
            return

        def done(result: Frame | CmError) -> None:
            if isinstance(result, CmError):
                respond(Reply(error=error_info(result)))
            else:
                respond(Reply(result.info, payload=(bytes(result.data),)))

        self._s.streams.read_once(request.stream, request.timeout, done)

    def _write_data(self, request: rq.WriteData, respond: Respond) -> None:
        desk = self._s.manager.memories
        if request.offset or desk.find(request.stream):
            self._transfer(desk.begin_write(request.stream, request.offset, request.data, request.lease), respond)
            return

        def done(result: Frame | CmError) -> None:
            respond(Reply(error=error_info(result)) if isinstance(result, CmError) else Reply(result.info))

        self._s.streams.write(request.stream, request.data, done, request.lease)

    def _transfer(self, transfer: Transfer, respond: Respond) -> None:
        def done(problem: Exception | None) -> None:
            if problem is not None:
                self.refuse(problem, respond)
                return
            state, payload = self._s.manager.state, () if transfer.write else (transfer.data,)
            respond(Reply(frame_info(transfer, state.config or "", state.mode or ""), payload=payload))

        self._s.memories.start(transfer, done)

    def _read_irq(self, request: rq.ReadIrq, respond: Respond) -> None:
        config = self._s.manager.loaded_config()
        known = config.interrupts if config else {}
        if request.name not in known:
            raise UnknownInterrupt(f"no interrupt {request.name!r}{hint(request.name, known)}")
        respond(Reply(self._s.interrupts.latest(request.name)))

    def _lease(self, request: rq.TakeLease, respond: Respond) -> None:
        info = self._s.manager.leases.request(request)
        self._s.watch_holder(info, request)
        respond(Reply(info))


def _ended(change: Change) -> Reply:
    if change.error is not None:
        return Reply(error=change.error)
    return Reply(ChangeInfo(change.number, done=True, seconds=change.seconds))
