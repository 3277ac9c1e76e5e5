# SPDX-License-Identifier: Apache-2.0
"""What each request does. A handler returns the reply, or work in steps that does, or None: it answers later.

`cm.server.requests` says which is whose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TypeVar

from cm.errors import Busy, CmError, InvalidRequest
from cm.frozen import dataclass, replace
from cm.manager.access.leases import check_scope_names_something
from cm.manager.access.memory_service import Transfer
from cm.manager.access.register_service import AT_ONCE, ReadPieces, WritePieces
from cm.manager.errors import ChangeBusy, UnknownInterrupt, UnknownStream, hint
from cm.manager.execution.region_readback import Checked
from cm.manager.execution.worker import QUEUE_LENGTH, Change
from cm.manager.manager import Manager
from cm.manager.status_reports import config_list, is_long
from cm.schema.model import Config, Stream
from cm.server.audit_events import AuditEvents
from cm.server.board_watch import BoardWatch
from cm.server.client_quotas import Client, Clients
from cm.server.connections import Connections
from cm.server.error_replies import refusal
from cm.server.interrupts import InterruptWatch
from cm.server.lease_watch import LeaseWatch
from cm.server.long_work import NOT_YET, FileThread, Result, RoundRobin
from cm.server.provision import Provisioner, Sender
from cm.server.rights.admission import check
from cm.server.rights.model import Role
from cm.server.rights.required_rights import provisioning
from cm.server.sender_order import Asked, Holds, Work
from cm.server.sockets import Loop
from cm.server.streams.running import Streams
from cm.server.streams.stream import Frame
from cm.server.uploads import Uploads
from cm.wire.encode import encode_body, encoded
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
from cm.wire.protobuf_messages import encoded_registers

CHANGES_EACH = QUEUE_LENGTH - 1  # of one user, beside the one that runs: the last two are for others
_PID_MAX = 1 << 22  # PID_MAX_LIMIT of Linux
_OPERATE = Role.OPERATE  # looking it up in the enum's class takes time
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Services:
    """What the handlers work with."""

    loop: Loop
    manager: Manager
    streams: Streams
    interrupts: InterruptWatch
    provisioner: Provisioner
    leases: LeaseWatch
    board: BoardWatch
    status: Callable[[], Status]
    complete: Callable[[Config], Config]  # adds what only the board knows
    renew_config: Callable[[str], None]  # applies a new schema that waits for the end of its configuration
    turns: RoundRobin
    clients: Clients
    connections: Connections
    uploads: Uploads
    files: FileThread
    audits: AuditEvents

    def fail(self, asked: Asked, error: Exception) -> None:
        """Answer with an error that work has ended in; that the board has gone is noticed."""
        self.board.notice_error(error)
        asked.answer(refusal(error))

    def read_files(self, asked: Asked, work: Callable[[], _T], then: Callable[[_T], Reply | None]) -> None:
        """Do what reads or writes files beside the loop, then answer with what `then` makes of it. Raises Busy."""

        def ended(result: Result[_T]) -> None:
            try:
                reply = then(result())
            except Exception as error:  # noqa: BLE001 (every request gets an answer)
                self.fail(asked, error)
            else:
                if reply is not None:
                    asked.answer(reply)

        self.files.submit(asked.client, work, ended)


def carry_out(s: Services, asked: Asked) -> None:
    """Do what a request asks for; whatever goes wrong becomes an error reply."""
    if s.audits.publisher.wants_audit and asked.row.right.least.role >= _OPERATE:
        asked.audit = s.audits.begin(asked)
    try:
        asked.request = s.connections.gate.admit(asked.connection, asked.request, asked.row.right, s.connections.scene)
        if asked.row.uploads:
            s.uploads.fill_in(asked)
    except CmError as error:
        asked.answer(refusal(error))
        return
    try:
        made = asked.row.handler(s, asked, asked.request)
        if isinstance(made, Reply):
            asked.answer(made)
        elif made is not None:
            s.turns.start(asked.client, _answered(s, asked, made))
        if asked.audit is not None and not asked.answered:
            asked.audit(None)
    except Exception as error:  # noqa: BLE001 (every request gets an answer)
        s.fail(asked, error)


def _answered(s: Services, asked: Asked, work: Work) -> Iterator[object]:
    try:
        reply = yield from work
    except Exception as error:  # noqa: BLE001 (every request gets an answer)
        s.fail(asked, error)
    else:
        asked.answer(reply)


# ---- registers ------------------------------------------------------------------------------


def read_reg(s: Services, asked: Asked, request: rq.ReadReg) -> Reply | Work:
    """Many are read piece by piece."""
    registers, names = s.manager.registers, request.names
    if len(names or registers.visible_names()) <= AT_ONCE:
        return Reply(registers.read(names))
    asked.hold(Holds.LONG)
    return _by_pieces(ReadPieces(registers, names))


def write_reg(s: Services, asked: Asked, request: rq.WriteReg) -> Reply | Work:
    """Many are written piece by piece; what was written is told, even if that is not all."""
    manager, writes = s.manager, request.writes
    if len(writes) <= AT_ONCE:
        return Reply(manager.write_registers(writes, request.lease, asked.client.who))
    asked.hold(Holds.LONG)
    tell = partial(manager.tell_registers, by=asked.client.who)
    return _by_pieces(WritePieces(manager.registers, writes, request.lease), tell)


def _by_pieces(work: ReadPieces | WritePieces, tell: Callable[[RegValues], object] = lambda _: None) -> Work:
    """Values are encoded as they come: all at once would take longer than any piece."""
    parts: list[bytes] = []
    ended = False
    try:
        while not ended:
            ended = work.step()
            parts.append(encoded(RegValues(tuple(work.newest))))
            if not ended:
                yield None
    except Exception:
        if work.result.values:
            tell(encoded_registers(work.result, parts))
        raise
    values = encoded_registers(work.result, parts)
    tell(values)
    return Reply(values)


# ---- status and configurations --------------------------------------------------------------


def read_status(s: Services, _: Asked, request: rq.ReadStatus) -> Reply:
    """With what each client has, or what has happened, if that is asked for."""
    status = s.status()
    if request.clients:
        held = s.connections.counted(), status.leases, status.streams, s.streams.allocated()
        status = replace(status, clients=s.clients.statuses(*held))
    if request.history:
        history = s.manager.reporter.history
        status = replace(status, changes=history.changes(), writes=history.writes())
    s.manager.reporter.was_read()
    return Reply(status)


def read_config(s: Services, asked: Asked, request: rq.ReadConfig) -> Reply | None:
    """Describe one; of a long one that takes 0.15 s, and is done beside the loop."""
    manager, counts = s.manager, dict(s.interrupts.counts)

    def described() -> ConfigInfo:
        info = manager.describe(request.config_name, counts)
        blocks = manager.memories.defined() if info.mode else ()  # at run time, for the loaded one
        return replace(info, memories=(*info.memories, *blocks)) if blocks else info

    if not is_long(manager.configs.get(request.config_name or manager.state.config or "")):
        return Reply(described())
    s.read_files(asked, lambda: encode_body(described()), lambda made: Reply(encoded=made))
    return None


def plan_change(s: Services, asked: Asked, request: rq.PlanChange) -> None:
    """What going there would do."""
    s.read_files(
        asked, partial(s.manager.plan, rq.ChangeMode(request.config_name, request.mode, unload=request.unload)), Reply
    )


def change_mode(s: Services, asked: Asked, request: rq.ChangeMode) -> Reply | None:
    """Answered when it has ended, or now."""
    if request.force:
        s.renew_config(request.config_name)
    change = _begin_change(s, asked, partial(s.manager.submit, request, by=asked.client.who))
    return Reply(ChangeInfo(change.number, done=False)) if request.no_wait else None


def _begin_change(s: Services, asked: Asked, submit: Callable[[Callable[[Change], None]], Change]) -> Change:
    """Have a client's change accepted, and answer when it has ended, unless that was done before."""
    client, order = asked.client, asked.order
    _check_changes(client)

    def ended(change: Change) -> None:
        asked.answer(change.reply())
        client.changes -= 1
        order.ended(asked.sender, change)

    change = submit(lambda c: s.loop.call_threadsafe(partial(ended, c)))
    client.changes += 1
    order.began(asked.sender, change)  # its end is reported in a later turn of the loop
    return change


def _check_changes(client: Client) -> None:
    own = sum(one.changes for one in client.user.clients)
    if own >= CHANGES_EACH:
        raise Busy(f"{own} changes and checks of {client.account} wait or run; try again when one has ended")


def cancel_change(s: Services, _: Asked, request: rq.CancelChange) -> Reply:
    """Tell the running change to end."""
    s.manager.cancel(request.number)
    return Reply(s.status())


def provision(s: Services, asked: Asked, request: rq.Provision) -> None:
    """Store a configuration, then go to it if that is asked for."""
    asked.hold(Holds.STORES)
    s.manager.leases.check(("config",), request.lease)
    whose = name_check(s, asked.connection), sender_of(s, asked.connection)

    def store() -> tuple[Config, Mapping[str, str]]:
        config = s.provisioner.store(request.schema, request.files, *whose)
        return config, s.manager.images_of(config)

    def stored(made: tuple[Config, Mapping[str, str]]) -> Reply | None:
        config, images = made
        s.manager.add_config(s.complete(config), images)
        if request.change is None:
            return read_config(s, asked, rq.ReadConfig(config.name))
        return change_mode(s, asked, replace(request.change, config_name=config.name))

    s.read_files(asked, store, stored)


def remove_config(s: Services, asked: Asked, request: rq.RemoveConfig) -> None:
    """Forget one that a client sent."""
    asked.hold(Holds.STORES)
    s.manager.leases.check(("config",), request.lease)
    if s.manager.in_use(request.config_name):
        raise ChangeBusy(f"configuration {request.config_name!r} is in use; load another first")

    def removed(_: object) -> Reply:
        s.manager.forget_config(request.config_name)
        return list_configs(s)

    s.read_files(asked, partial(s.provisioner.remove, request.config_name, sender_of(s, asked.connection)), removed)


def upload(s: Services, asked: Asked, request: rq.Upload) -> Reply:
    """Keep a part."""
    return Reply(s.uploads.take(asked.client, request))


def list_configs(s: Services, *_: object) -> Reply:
    """All configurations, with their origins."""
    plain, owned, reserved = config_list(s.manager.configs), s.provisioner.owned, s.provisioner.reserved
    entries = []
    for entry in plain.entries:
        whose = None if entry.name in reserved else owned.get(entry.name)
        said = ("client", whose.name, whose.bytes) if whose else ("administrator", "", 0)
        entries.append(replace(entry, origin=said[0], owner=said[1], bytes=said[2]))
    return Reply(replace(plain, entries=tuple(entries)))


def sender_of(s: Services, connection: str) -> Sender:
    """Who sends a configuration over a connection."""
    who = s.connections.gate.principal(connection)
    return Sender(who.account, str(who), s.connections.gate.everywhere(connection) >= Role.ADMIN)


def name_check(s: Services, connection: str) -> Callable[[str], None]:
    """The check of a configuration's name, made in another thread once it is known: Forbidden, ChangeBusy."""
    who, rights = s.connections.gate.principal(connection), s.connections.gate.rights(connection)

    def ask(name: str) -> None:
        check(who, rights, provisioning(name))
        s.manager.check_replaceable(name)

    return ask


# ---- streams and memories -------------------------------------------------------------------


def describe_data(s: Services, _: Asked, request: rq.DescribeData) -> Reply:
    """A memory, or a stream."""
    memories = s.manager.memories
    memory = memories.find(request.name)
    if memory is not None:
        return Reply(memories.info(memory))
    stream = _stream(s, request.name)
    s.streams.check_lease(stream, request.lease)
    return Reply(s.streams.status_of(stream.name))


def configure_stream(s: Services, asked: Asked, request: rq.ConfigureStream) -> None:
    """Answered once it runs again, if it is wanted."""
    s.manager.memories.check_no_memory(request.stream)
    s.streams.check_lease(_stream(s, request.stream), request.lease)
    s.streams.configure(request, partial(_answer_with, s, asked))


def define_memory(s: Services, _: Asked, request: rq.DefineMemory) -> Reply:
    """Until the next change of configuration."""
    return Reply(s.manager.memories.info(s.manager.memories.define(request)))


def read_data(s: Services, asked: Asked, request: rq.ReadData) -> Work | None:
    """The next frame, or part of a memory."""
    memories = s.manager.memories
    if request.offset or request.length or memories.find(request.stream):
        return _transfer(s, asked, memories.begin_read(request.stream, request.offset, request.length))
    if request.stream:
        _stream(s, request.stream)
    asked.client.check_room()

    def came(result: Frame | Exception) -> None:
        if isinstance(result, Frame):
            asked.answer(Reply(result.info, payload=(result.data,)))
        else:
            s.fail(asked, result)

    s.streams.read_once(request.stream, request.timeout, came)
    return None


def write_data(s: Services, asked: Asked, request: rq.WriteData) -> Work | None:
    """A frame, or part of a memory."""
    memories = s.manager.memories
    if request.offset or memories.find(request.stream):
        asked.hold(Holds.WRITES)
        written = memories.begin_write(request.stream, request.offset, request.data, request.lease)
        return _transfer(s, asked, written)
    if request.stream:
        stream = _stream(s, request.stream)
        if request.format and stream.format and request.format != stream.format:
            raise OtherPixels(f"stream {stream.name!r} takes pixels of {stream.format}, not {request.format}")

    def taken(result: Frame | Exception) -> None:
        _answer_with(s, asked, result.info if isinstance(result, Frame) else result)

    s.streams.write(request.stream, request.data, taken, request.lease)
    return None


def _stream(s: Services, name: str) -> Stream:
    """A stream by name. Raises UnknownStream, which names the memories too: one of them may have been meant."""
    try:
        return s.streams.named(name, None)
    except UnknownStream as error:
        raise UnknownStream(f"{error}{s.manager.memories.listed()}") from None


def _answer_with(s: Services, asked: Asked, result: StreamStatus | FrameInfo | RegionCheck | Exception) -> None:
    if isinstance(result, Exception):
        s.fail(asked, result)
    else:
        asked.answer(Reply(result))


def _transfer(s: Services, asked: Asked, transfer: Transfer) -> Work:
    """A read begins when its client has room for the answer."""
    client, reserved = asked.client, 0
    if not transfer.write:
        while not client.has_room(transfer.length):
            yield NOT_YET
        reserved = transfer.length
        client.make(reserved)
    try:
        while not transfer.step():
            yield None
    finally:
        client.make(-reserved)
    (shape, dtype), state = transfer.form, s.manager.state
    info = FrameInfo(
        transfer.memory.name, 0, time.monotonic_ns(), transfer.length, shape, dtype, state.config or "",
        state.mode or "", offset=transfer.offset,
    )  # fmt: skip
    return Reply(info, payload=() if transfer.write else (transfer.data,))


class OtherPixels(InvalidRequest):
    """A picture for a stream whose pixels lie in another order in memory."""

    code = PIXEL_FORMAT


# ---- regions, interrupts and leases ---------------------------------------------------------


def check_region(s: Services, asked: Asked, request: rq.CheckRegion) -> None:
    """Compare its frames with what was loaded; to repair it is a change."""
    manager, client = s.manager, asked.client
    if request.repair:
        _begin_change(s, asked, partial(manager.repair, request, by=client.who))
        return
    _check_changes(client)
    client.changes += 1

    def ended(result: RegionCheck | Exception) -> None:
        client.changes -= 1
        _answer_with(s, asked, result)

    def prepared(result: Result[Checked]) -> None:
        try:
            manager.check(result(), lambda found: s.loop.call_threadsafe(partial(ended, found)))
        except Exception as error:  # noqa: BLE001 (every request gets an answer)
            ended(error)

    try:
        s.files.submit(client, partial(manager.prepared_check, request.name), prepared)
    except Busy:
        client.changes -= 1
        raise


def map_region(s: Services, asked: Asked, request: rq.MapRegion) -> None:
    """What was loaded into it, counted."""
    s.read_files(asked, partial(s.manager.region_map, request.name), Reply)


def read_irq(s: Services, _: Asked, request: rq.ReadIrq) -> Reply:
    """The count and last time of an interrupt."""
    config = s.manager.loaded_config()
    known = config.interrupts if config else {}
    if request.name not in known:
        raise UnknownInterrupt(f"no interrupt {request.name!r}{hint(request.name, known)}")
    return Reply(s.interrupts.latest(request.name))


def take_lease(s: Services, asked: Asked, request: rq.TakeLease) -> Reply:
    """On something that there is."""
    defined = [memory.name for memory in s.manager.memories.defined()]
    check_scope_names_something(request.scope, s.manager.configs.values(), defined)
    return lease(s, asked, request)


def lease(s: Services, asked: Asked, request: rq.TakeLease | rq.RenewLease | rq.ReleaseLease | rq.BreakLease) -> Reply:
    """Renew it, give it back, or end another's."""
    if isinstance(request, (rq.TakeLease, rq.RenewLease)) and request.pid > _PID_MAX:
        raise InvalidRequest(f"pid {request.pid}: no process has a number above {_PID_MAX}; 0: it is elsewhere")
    info = s.manager.leases.request(request, asked.client.name, asked.client.account)
    s.leases.follow(info, request, asked.client.name)
    return Reply(info)
