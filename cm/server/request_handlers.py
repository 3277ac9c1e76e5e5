# SPDX-License-Identifier: Apache-2.0
"""What each request does: the handlers, by the request's class."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeVar

from cm.errors import Busy, CmError, InvalidRequest
from cm.frozen import dataclass, replace
from cm.manager.access.leases import check_scope_names_something
from cm.manager.access.memory_service import MemoryService, Transfer
from cm.manager.access.register_service import AT_ONCE, ReadPieces, RegisterService, WritePieces
from cm.manager.errors import ChangeBusy, UnknownInterrupt, UnknownStream, hint
from cm.manager.execution.region_readback import Checked
from cm.manager.execution.worker import QUEUE_LENGTH, Change
from cm.manager.manager import Manager
from cm.manager.status_reports import config_list, is_long
from cm.schema.model import Config, Stream
from cm.server.board_watch import BoardWatch
from cm.server.client_quotas import Client, Clients, with_holdings
from cm.server.connections import Connections, Sessions
from cm.server.error_replies import Respond, error_info, refusal
from cm.server.interrupts import InterruptWatch
from cm.server.lease_watch import LeaseWatch
from cm.server.long_work import ClientJobs, Done, Result, Steps
from cm.server.provision import Provisioner, Sender
from cm.server.rights.admission import Gate, check
from cm.server.rights.model import Role
from cm.server.rights.required_rights import provisioning
from cm.server.sockets import Loop
from cm.server.streams.running import Streams
from cm.server.streams.stream import Frame
from cm.server.uploads import Uploads
from cm.wire.encode import encode_config
from cm.wire.messages import requests as rq
from cm.wire.messages.status import (
    PIXEL_FORMAT,
    ChangeInfo,
    ConfigInfo,
    FrameInfo,
    RegionCheck,
    RegValues,
    Reply,
    Status,
    StreamStatus,
)
from cm.wire.protobuf_messages import encode_values, encoded_registers


def takes_long(request: rq.ReadReg | rq.WriteReg, registers: RegisterService) -> bool:
    """Whether a request is for so many registers that it is done piece by piece."""
    named = request.writes if isinstance(request, rq.WriteReg) else request.names or registers.visible_names()
    return len(named) > AT_ONCE


class RegisterHandlers:
    """As `Handlers`, which has them in its table."""

    def __init__(self, manager: Manager, steps: Steps, board: BoardWatch) -> None:
        self._manager = manager
        self._steps = steps
        self._board = board

    @property
    def table(self) -> Mapping[type, Callable[..., None]]:
        """The handler of each kind of request."""
        return {rq.ReadReg: self._read_reg, rq.WriteReg: self._write_reg}

    def _read_reg(self, request: rq.ReadReg, respond: Respond, client: Client) -> None:
        registers = self._manager.registers
        if takes_long(request, self._manager.registers):
            self._by_pieces(client, ReadPieces(registers, request.names), respond)
        else:
            respond(Reply(registers.read(request.names)))

    def _write_reg(self, request: rq.WriteReg, respond: Respond, client: Client) -> None:
        if takes_long(request, self._manager.registers):
            pieces = WritePieces(self._manager.registers, request.writes, request.lease)
            self._by_pieces(client, pieces, respond, self._manager.tell_registers)
        else:
            respond(Reply(self._manager.write_registers(request.writes, request.lease)))

    def _by_pieces(
        self,
        client: Client,
        work: ReadPieces | WritePieces,
        respond: Respond,
        then: Callable[[RegValues], object] = lambda _: None,
    ) -> None:
        """`then` gets what was done, even if that is not all."""

        encoded = _Encoded(work)

        def done(problem: Exception | None) -> None:
            result = encoded.result()
            if result.values:
                then(result)
            if problem is not None:
                self._board.noticed(problem)
            respond(Reply(result) if problem is None else refusal(problem))

        self._steps.start(client, encoded, done)


class _Encoded:
    """A job whose values are encoded as they come: encoding all at once would take longer than any piece."""

    def __init__(self, work: ReadPieces | WritePieces) -> None:
        self._work = work
        self._parts: list[bytes] = []

    def step(self) -> bool:
        """As the work's."""
        ended = self._work.step()
        self._parts.append(encode_values(self._work.newest))
        return ended

    def result(self) -> RegValues:
        """What was done."""
        return encoded_registers(self._work.result, self._parts)


class Description:
    """What a client is told of a configuration. Of a long one that takes 0.15 s, and is done beside the loop."""

    def __init__(self, manager: Manager, memories: MemoryTransfers, name: str, counts: Mapping[str, int]) -> None:
        """`name` is empty for the loaded one; `counts` of its interrupts."""
        self._manager = manager
        self._memories = memories
        self._name = name
        self._counts = counts

    @property
    def is_long(self) -> bool:
        """Whether it takes longer than a request may."""
        return is_long(self._manager.configs.get(self._name or self._manager.state.config or ""))

    def info(self) -> ConfigInfo:
        """Any thread. Raises UnknownConfig, NothingLoaded."""
        return self._memories.described(self._manager.describe(self._name, self._counts))

    def encoded(self) -> bytes:
        """The same, as it stands in the reply."""
        return encode_config(self.info())


class SentConfigs:
    """Configurations that clients sent, and who may do what with them. The loop's thread."""

    def __init__(self, manager: Manager, provisioner: Provisioner, sessions: Sessions) -> None:
        self._manager = manager
        self._provisioner = provisioner
        self._sessions = sessions

    def listed(self) -> ConfigInfo:
        """All configurations, with their origins."""
        listed, owned = config_list(self._manager.configs), self._provisioner.owned
        reserved = self._provisioner.reserved
        entries = []
        for entry in listed.entries:
            whose = None if entry.name in reserved else owned.get(entry.name)
            said = ("client", whose.name, whose.bytes) if whose else ("administrator", "", 0)
            entries.append(replace(entry, origin=said[0], owner=said[1], bytes=said[2]))
        return replace(listed, entries=tuple(entries))

    def sender(self, connection: str) -> Sender:
        """The sender on a connection."""
        who = self._sessions.gate.principal(connection)
        return Sender(who.account, str(who), self._sessions.gate.everywhere(connection) >= Role.ADMIN)

    def allowed(self, connection: str) -> Callable[[str], None]:
        """The check of a configuration's name, made in another thread once it is known: Forbidden, ChangeBusy."""
        who, rights = self._sessions.gate.principal(connection), self._sessions.gate.rights(connection)

        def ask(name: str) -> None:
            check(who, rights, provisioning(name))
            self._manager.check_replaceable(name)

        return ask

    def check_removable(self, name: str) -> None:
        """Raise ChangeBusy while a configuration is loaded, or a change may need it."""
        if self._manager.in_use(name):
            raise ChangeBusy(f"configuration {name!r} is in use; load another first")


class OtherPixels(InvalidRequest):
    """A picture for a stream whose pixels lie in another order in memory."""

    code = PIXEL_FORMAT


class MemoryTransfers:
    """Transfers of a client one after the other, clients by turns. Everything in the loop's thread."""

    def __init__(self, steps: Steps, memories: MemoryService) -> None:
        self._steps = steps
        self._memories = memories

    def described(self, info: ConfigInfo) -> ConfigInfo:
        """A configuration with the memories that were defined for it, if it is the loaded one."""
        blocks = self._memories.defined() if info.mode else ()
        return replace(info, memories=(*info.memories, *blocks)) if blocks else info

    def start(self, client: Client, transfer: Transfer, done: Done) -> None:
        """Begin a transfer, a read when its client has room for the answer.

        `done` is called once, now or later, with the error, if any. Raises Busy.
        """
        if transfer.write:
            self._steps.start(client, transfer, done)
            return
        reserved = 0

        def may_begin() -> bool:
            nonlocal reserved
            if client.has_room(transfer.length):
                reserved = transfer.length
                client.make(reserved)
            return reserved > 0

        def ended(problem: Exception | None) -> None:
            client.make(-reserved)
            done(problem)

        self._steps.start(client, transfer, ended, may_begin)


def frame_info(transfer: Transfer, config: str, mode: str) -> FrameInfo:
    """What accompanies the payload of a memory."""
    shape, dtype = transfer.form
    memory, length = transfer.memory, transfer.length
    return FrameInfo(memory.name, 0, time.monotonic_ns(), length, shape, dtype, config, mode, offset=transfer.offset)


class DataHandlers:
    """As `Handlers`, which has them in its table."""

    def __init__(self, manager: Manager, streams: Streams, transfers: MemoryTransfers, board: BoardWatch) -> None:
        self._manager = manager
        self._memories = manager.memories
        self._streams = streams
        self._transfers = transfers
        self._board = board

    @property
    def table(self) -> Mapping[type, Callable[..., None]]:
        """The handler of each kind of request."""
        return {
            rq.DescribeData: self._describe_data,
            rq.ConfigureStream: self._configure_stream,
            rq.DefineMemory: self._define_memory,
            rq.ReadData: self._read_data,
            rq.WriteData: self._write_data,
        }

    def _describe_data(self, request: rq.DescribeData, respond: Respond) -> None:
        memory = self._memories.find(request.name)
        if memory is not None:
            respond(Reply(self._memories.info(memory)))
            return
        stream = self._stream(request.name)
        self._streams.check_lease(stream, request.lease)
        respond(Reply(self._streams.status_of(stream.name)))

    def _configure_stream(self, request: rq.ConfigureStream, respond: Respond) -> None:
        self._memories.check_no_memory(request.stream)
        self._streams.check_lease(self._stream(request.stream), request.lease)
        self._streams.configure(request, partial(self._told, respond))

    def _told(self, respond: Respond, result: StreamStatus | FrameInfo | Exception) -> None:
        if isinstance(result, Exception):
            self._board.noticed(result)
            respond(Reply(error=error_info(result)))
        else:
            respond(Reply(result))

    def _define_memory(self, request: rq.DefineMemory, respond: Respond) -> None:
        respond(Reply(self._memories.info(self._memories.define(request))))

    def _stream(self, name: str) -> Stream:
        """A stream by name. Raises UnknownStream, which names the memories too: one of them may have been meant."""
        try:
            return self._streams.named(name, None)
        except UnknownStream as error:
            raise UnknownStream(f"{error}{self._memories.listed()}") from None

    def _read_data(self, request: rq.ReadData, respond: Respond, client: Client) -> None:
        if request.offset or request.length or self._memories.find(request.stream):
            self._transfer(client, self._memories.begin_read(request.stream, request.offset, request.length), respond)
            return
        if request.stream:
            self._stream(request.stream)
        client.check_room()

        def done(result: Frame | CmError | OSError) -> None:
            if isinstance(result, Frame):
                respond(Reply(result.info, payload=(result.data,)))
            else:
                self._told(respond, result)

        self._streams.read_once(request.stream, request.timeout, done)

    def _write_data(self, request: rq.WriteData, respond: Respond, client: Client) -> None:
        if request.offset or self._memories.find(request.stream):
            written = self._memories.begin_write(request.stream, request.offset, request.data, request.lease)
            self._transfer(client, written, respond)
            return
        if request.stream:
            stream = self._stream(request.stream)
            if request.format and stream.format and request.format != stream.format:
                raise OtherPixels(f"stream {stream.name!r} takes pixels of {stream.format}, not {request.format}")

        def done(result: Frame | CmError | OSError) -> None:
            self._told(respond, result.info if isinstance(result, Frame) else result)

        self._streams.write(request.stream, request.data, done, request.lease)

    def _transfer(self, client: Client, transfer: Transfer, respond: Respond) -> None:
        def done(problem: Exception | None) -> None:
            if problem is None:
                respond(self._moved(transfer))
            else:
                self._board.noticed(problem)
                respond(refusal(problem))

        self._transfers.start(client, transfer, done)

    def _moved(self, transfer: Transfer) -> Reply:
        state, payload = self._manager.state, () if transfer.write else (transfer.data,)
        return Reply(frame_info(transfer, state.config or "", state.mode or ""), payload=payload)


_T = TypeVar("_T")
Began = Callable[[Change], Callable[[], None]]
CHANGES_EACH = QUEUE_LENGTH - 1  # of one client, beside the one that runs: the last two are for others


_LEASES = (rq.TakeLease, rq.RenewLease, rq.ReleaseLease, rq.BreakLease)
_OF_CLIENTS = frozenset(
    {
        rq.ReadReg,
        rq.WriteReg,
        rq.ReadData,
        rq.WriteData,
        rq.Upload,
        rq.PlanChange,
        rq.MapRegion,
        rq.ReadConfig,
        *_LEASES,
    }
)  # done by turns
_STORES = frozenset({rq.Provision, rq.RemoveConfig})
_UPLOADED = frozenset({rq.Provision, rq.WriteData})  # their data may have been uploaded before


@dataclass(frozen=True, slots=True)
class Services:
    """What the handlers work with."""

    loop: Loop
    manager: Manager
    streams: Streams
    interrupts: InterruptWatch
    provisioner: Provisioner
    leases: LeaseWatch
    memories: MemoryTransfers
    board: BoardWatch
    status: Callable[[], Status]
    complete: Callable[[Config], Config]  # adds what only the board knows
    renew_config: Callable[[str], None]  # applies a new schema that waits for the end of its configuration
    sessions: Sessions
    steps: Steps
    clients: Clients
    connections: Connections
    uploads: Uploads
    jobs: ClientJobs  # for work that reads or writes files, so that the loop goes on


class Handlers:
    """Dispatches requests. `respond` is called exactly once, now or later, in the loop's thread."""

    def __init__(self, services: Services) -> None:
        self._s = services
        self._sent = SentConfigs(services.manager, services.provisioner, services.sessions)
        self.table: dict[type, Callable[..., None]] = {
            rq.ReadStatus: self._read_status,
            rq.ReadConfig: self._read_config,
            rq.ListConfigs: self._list_configs,
            rq.PlanChange: self._plan_change,
            rq.ChangeMode: self._change_mode,
            rq.CancelChange: self._cancel_change,
            rq.Provision: self._provision,
            rq.RemoveConfig: self._remove_config,
            rq.Upload: self._upload,
            rq.CheckRegion: self._check_region,
            rq.MapRegion: self._map_region,
            rq.ReadIrq: self._read_irq,
            rq.TakeLease: self._lease,
            rq.RenewLease: self._lease,
            rq.ReleaseLease: self._lease,
            rq.BreakLease: self._lease,
            **RegisterHandlers(services.manager, services.steps, services.board).table,
            **DataHandlers(services.manager, services.streams, services.memories, services.board).table,
        }

    @property
    def gate(self) -> Gate:
        """Who may do what."""
        return self._s.sessions.gate

    @property
    def clients(self) -> Clients:
        """Who has what under way."""
        return self._s.clients

    @property
    def steps(self) -> Steps:
        """What is done a step in each turn of the loop."""
        return self._s.steps

    def handle(self, connection: str, request: rq.Request, respond: Respond, began: Began) -> None:
        """Carry out a request from a connection; whatever goes wrong becomes an error reply.

        A change that it requests is passed to `began`; what that returns is called when the change has ended.
        """
        kind = type(request)
        try:
            request = self._s.sessions.gate.admit(connection, request, self._s.sessions.scene)
            if kind in _UPLOADED:
                request, respond = self._s.uploads.filled_in(self._s.clients.of(connection), request, respond)
        except CmError as error:
            respond(refusal(error))
            return
        try:
            if kind in _OF_CLIENTS:
                self.table[kind](request, respond, self._s.clients.of(connection))
            elif kind is rq.ChangeMode:
                self._change_mode(request, respond, began, connection)  # type: ignore[arg-type]
            elif kind is rq.CheckRegion:
                self._check_region(request, respond, began, connection)  # type: ignore[arg-type]
            elif kind in _STORES:
                self.table[kind](request, respond, began, connection)
            else:
                self.table[kind](request, respond)
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            self._failed(error, respond)

    def _failed(self, error: Exception, respond: Respond) -> None:
        self._s.board.noticed(error)
        respond(refusal(error))

    def _guarded(self, call: Callable[[], None], respond: Respond) -> None:
        try:
            call()
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            self._failed(error, respond)

    def _run_job(self, client: Client, work: Callable[[], _T], then: Callable[[_T], None], respond: Respond) -> None:
        """Do `work` in another thread and continue with `then` in the loop's."""

        def finish(result: Result[_T]) -> None:
            self._guarded(lambda: then(result()), respond)

        self._s.jobs.submit(client, work, finish)

    # ---- status and configurations ------------------------------------------------------

    def _read_status(self, request: rq.ReadStatus, respond: Respond) -> None:
        status = self._s.status()
        if request.clients:
            held = status.leases, status.streams, self._s.streams.allocated()
            status = replace(status, clients=with_holdings(self._s.clients.told(self._s.connections.counted()), *held))
        respond(Reply(status))
        self._s.manager.reporter.was_read()

    def _read_config(self, request: rq.ReadConfig, respond: Respond, client: Client) -> None:
        counts = dict(self._s.interrupts.counts)
        description = Description(self._s.manager, self._s.memories, request.config_name, counts)
        if description.is_long:
            self._run_job(client, description.encoded, lambda made: respond(Reply(encoded=made)), respond)
        else:
            respond(Reply(description.info()))

    def _list_configs(self, _: rq.ListConfigs, respond: Respond) -> None:
        respond(Reply(self._sent.listed()))

    def _plan_change(self, request: rq.PlanChange, respond: Respond, client: Client) -> None:
        change = rq.ChangeMode(request.config_name, request.mode)
        self._run_job(client, lambda: self._s.manager.plan(change), lambda plan: respond(Reply(plan)), respond)

    def _change_mode(self, request: rq.ChangeMode, respond: Respond, began: Began, connection: str) -> None:
        if request.force:
            self._s.renew_config(request.config_name)
        respond_at_end = (lambda _: None) if request.no_wait else respond
        change = self._begin(partial(self._s.manager.submit, request), respond_at_end, began, connection)
        if request.no_wait:
            respond(Reply(ChangeInfo(change.number, done=False)))

    def _begin(
        self, submit: Callable[[Callable[[Change], None]], Change], respond: Respond, began: Began, connection: str
    ) -> Change:
        """Have a client's change accepted, and answer when it has ended."""
        client = self._s.clients.of(connection)
        if client.changes >= CHANGES_EACH:
            raise Busy(f"{client.changes} changes of {client.name} wait or run; try again when one has ended")
        ends: list[Callable[[], None]] = []

        def ended(change: Change) -> None:
            respond(change.reply())
            client.changes -= 1
            for end in ends:
                end()

        change = submit(lambda c: self._s.loop.call_threadsafe(partial(ended, c)))
        client.changes += 1
        ends.append(began(change))  # its end is reported in a later turn of the loop
        return change

    def _check_region(self, request: rq.CheckRegion, respond: Respond, began: Began, connection: str) -> None:
        manager = self._s.manager
        if request.repair:
            self._begin(partial(manager.repair, request), respond, began, connection)
            return

        client = self._s.clients.of(connection)
        if client.changes >= CHANGES_EACH:
            raise Busy(
                f"{client.changes} changes and checks of {client.name} wait or run; try again when one has ended"
            )

        def answer(reply: Reply) -> None:
            client.changes -= 1
            respond(reply)

        def ended(result: RegionCheck | Exception) -> None:
            if isinstance(result, Exception):
                self._failed(result, answer)
            else:
                answer(Reply(result))

        def prepared(what: Checked) -> None:
            manager.check(what, lambda result: self._s.loop.call_threadsafe(partial(ended, result)))

        self._run_job(client, partial(manager.prepared_check, request.name), prepared, answer)
        client.changes += 1

    def _map_region(self, request: rq.MapRegion, respond: Respond, client: Client) -> None:
        self._run_job(
            client, lambda: self._s.manager.region_map(request.name), lambda found: respond(Reply(found)), respond
        )

    def _cancel_change(self, request: rq.CancelChange, respond: Respond) -> None:
        self._s.manager.cancel(request.number)
        respond(Reply(self._s.status()))

    def _provision(self, request: rq.Provision, respond: Respond, began: Began, connection: str) -> None:
        self._s.manager.leases.check(("config",), request.lease)
        whose = self._sent.allowed(connection), self._sent.sender(connection)
        store = partial(self._stored, partial(self._s.provisioner.store, request.schema, request.files, *whose))
        client = self._s.clients.of(connection)
        then = partial(self._provisioned, request, respond, began, connection)
        self._run_job(client, store, then, respond)

    def _stored(self, store: Callable[[], Config]) -> tuple[Config, Mapping[str, str]]:
        config = store()
        return config, self._s.manager.images_of(config)

    def _provisioned(
        self,
        request: rq.Provision,
        respond: Respond,
        began: Began,
        connection: str,
        stored: tuple[Config, Mapping[str, str]],
    ) -> None:
        config, images = stored
        self._s.manager.add_config(self._s.complete(config), images)
        if request.change is None:
            self._read_config(rq.ReadConfig(config.name), respond, self._s.clients.of(connection))
        else:
            self._change_mode(replace(request.change, config_name=config.name), respond, began, connection)

    def _remove_config(self, request: rq.RemoveConfig, respond: Respond, _: Began, connection: str) -> None:
        self._s.manager.leases.check(("config",), request.lease)
        self._sent.check_removable(request.config_name)
        remove = partial(self._s.provisioner.remove, request.config_name, self._sent.sender(connection))
        client = self._s.clients.of(connection)
        self._run_job(client, remove, lambda _: self._removed(request.config_name, respond), respond)

    def _removed(self, name: str, respond: Respond) -> None:
        self._s.manager.forget_config(name)
        respond(Reply(self._sent.listed()))

    def _upload(self, request: rq.Upload, respond: Respond, client: Client) -> None:
        respond(Reply(self._s.uploads.take(client, request)))

    # ---- interrupts and leases ------------------------------------------------------------

    def _read_irq(self, request: rq.ReadIrq, respond: Respond) -> None:
        config = self._s.manager.loaded_config()
        known = config.interrupts if config else {}
        if request.name not in known:
            raise UnknownInterrupt(f"no interrupt {request.name!r}{hint(request.name, known)}")
        respond(Reply(self._s.interrupts.latest(request.name)))

    def _lease(
        self, request: rq.TakeLease | rq.RenewLease | rq.ReleaseLease | rq.BreakLease, respond: Respond, client: Client
    ) -> None:
        if isinstance(request, rq.TakeLease):
            manager = self._s.manager
            defined = [memory.name for memory in manager.memories.defined()]
            check_scope_names_something(request.scope, manager.configs.values(), defined)
        self._s.leases.check_process(request)
        info = self._s.manager.leases.request(request, client.name)
        self._s.leases.follow(info, request, client.name)
        respond(Reply(info))
