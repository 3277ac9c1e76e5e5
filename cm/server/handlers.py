# SPDX-License-Identifier: Apache-2.0
"""One handler per kind of request: from a frozen request to calls of manager and streams, and a reply."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

from cm.errors import Busy, CmError
from cm.manager.access.leases import check_scope_names_something
from cm.manager.errors import UnknownInterrupt
from cm.manager.execution.worker import QUEUE_LENGTH, Change
from cm.manager.manager import Manager
from cm.manager.planner import hint
from cm.schema.model import Config
from cm.server.board_watch import BoardWatch
from cm.server.client_jobs import ClientJobs, Result
from cm.server.config_handlers import Description, SentConfigs
from cm.server.connections import Connections, Sessions
from cm.server.data_handlers import DataHandlers, MemoryTransfers
from cm.server.interrupts import InterruptWatch
from cm.server.lease_watch import LeaseWatch
from cm.server.provision import Provisioner
from cm.server.register_handlers import RegisterHandlers
from cm.server.replies import Respond, refusal
from cm.server.rights.gate import Gate
from cm.server.shares import Client, Clients, with_holdings
from cm.server.sockets import Loop
from cm.server.steps import Steps
from cm.server.streams.running import Streams
from cm.server.uploads import Uploads
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ChangeInfo, Reply, Status

_T = TypeVar("_T")
Began = Callable[[Change], Callable[[], None]]
CHANGES_EACH = QUEUE_LENGTH - 1  # of one client, beside the one that runs: the last two are for others


_LEASES = (rq.TakeLease, rq.RenewLease, rq.ReleaseLease, rq.BreakLease)
_OF_CLIENTS = frozenset(
    {rq.ReadReg, rq.WriteReg, rq.ReadData, rq.WriteData, rq.Upload, rq.PlanChange, rq.ReadConfig, *_LEASES}
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
        client = self._s.clients.of(connection)
        if client.changes >= CHANGES_EACH:
            raise Busy(f"{client.changes} changes of {client.name} wait or run; try again when one has ended")
        ends: list[Callable[[], None]] = []

        def ended(change: Change) -> None:
            if not request.no_wait:
                respond(change.reply())
            client.changes -= 1
            for end in ends:
                end()

        change = self._s.manager.submit(request, lambda c: self._s.loop.call_threadsafe(partial(ended, c)))
        client.changes += 1
        ends.append(began(change))  # its end is reported in a later turn of the loop
        if request.no_wait:
            respond(Reply(ChangeInfo(change.number, done=False)))

    def _cancel_change(self, _: rq.CancelChange, respond: Respond) -> None:
        self._s.manager.cancel()
        respond(Reply(self._s.status()))

    def _provision(self, request: rq.Provision, respond: Respond, began: Began, connection: str) -> None:
        self._s.manager.leases.check(("config",), request.lease)
        whose = self._sent.allowed(connection), self._sent.sender(connection)
        store = partial(self._s.provisioner.store, request.schema, request.files, *whose)
        client = self._s.clients.of(connection)
        then = partial(self._provisioned, request, respond, began, connection)
        self._run_job(client, store, then, respond)

    def _provisioned(
        self, request: rq.Provision, respond: Respond, began: Began, connection: str, config: Config
    ) -> None:
        self._s.manager.add_config(self._s.complete(config))
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
