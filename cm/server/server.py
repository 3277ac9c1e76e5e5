# SPDX-License-Identifier: Apache-2.0
"""The configuration manager as a daemon: puts sockets, loop, manager and streams together."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import zmq

from cm.errors import sentence
from cm.manager.access.leases import Leases
from cm.manager.manager import Environment, Manager
from cm.manager.state.journal import Journal
from cm.server.audit_events import AuditEvents
from cm.server.bitstream_and_overlay_files import BoardFiles
from cm.server.board_watch import BoardWatch
from cm.server.client_quotas import Clients
from cm.server.connections import Connections, raise_descriptors
from cm.server.devices import BoardDevices
from cm.server.dispatcher import Dispatcher
from cm.server.interrupts import InterruptWatch
from cm.server.lease_watch import LeaseWatch
from cm.server.long_work import FileThread, RoundRobin
from cm.server.options import Options, Reloaded
from cm.server.private_folders import Locks, private_folder
from cm.server.provision import Provisioner
from cm.server.publisher import Publisher, StatusPublisher, mark
from cm.server.reload import Reloader
from cm.server.request_handlers import Services
from cm.server.rights.admission import Gate
from cm.server.rights.policy import system_users
from cm.server.sensor_watch import SensorWatch
from cm.server.sockets import Authenticator, Loop, Sockets
from cm.server.streams.data_socket import DataSocket, Serve
from cm.server.streams.running import Streams
from cm.server.streams.undeclared_streams import with_channels
from cm.server.systemd import ServiceManager
from cm.server.uploads import Uploads
from cm.wire.messages.requests import ChangeMode
from cm.wire.plane_packets import Open, Purpose

if TYPE_CHECKING:
    import socket

    from cm.server.client_process import Peer
    from cm.server.local_reads import LocalReads
    from cm.server.window_clients import OpenWindows

_LOG = logging.getLogger("cm")
_TICK = 1.0  # seconds between two checks of streams, records and a lost board


class Server:
    """Serves until `stop()`. Everything but `stop` runs in the calling thread."""

    def __init__(self, options: Options) -> None:
        self._options = options
        self._with_channels = partial(with_channels, root=options.root)
        self._locks = Locks(options.runtime_dir, options.root, options.group)
        self._loop = Loop()
        gate = Gate(options.access, system_users())
        raise_descriptors()
        limits = options.limits
        self._clients = Clients(limits, gate.principal)
        self._uploads = Uploads(options.state_dir, limits, self._clients.upload_bytes)
        self._turns = RoundRobin(self._loop)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._devices = BoardDevices(options.root, options.assume_loaded)
        private_folder(options.state_dir)
        self._provisioner = Provisioner(options.state_dir / "configs", options.unsigned, limits)
        self._journal = Journal(options.state_dir)
        self._files = FileThread(self._loop)
        self._provisioner.recover()
        named = self._provisioner.standing(options.configs, options.example)
        configs = {name: self._with_channels(config) for name, config in named.items()}
        waiting = mark(configs.values(), options.queue_bytes)
        self._sockets = Sockets(self._context, options.runtime_dir, waiting, options.limits, options.group)
        self._authenticator = Authenticator(self._context, gate.enter)
        self._connections = Connections(gate, options.runtime_dir, self._sockets.tcp)
        self._publisher = Publisher(
            self._loop,
            self._sockets.pub,
            options.name,
            end=self._connections.end,
            end_stuck=self._connections.end_stuck,
            limit=options.queue_bytes,
        )
        leases = Leases(time, options.limits.leases, options.limits.leases_each)
        self._streams = Streams(
            self._loop,
            self._devices,
            subscribers=self._publisher,
            leases=leases,
            rights=self._connections,
            on_error=lambda error: self._manager.note_error(error),  # noqa: PLW0108 (which is made after it)
            turns=self._turns,
            limits=options.limits,
        )
        self._status = StatusPublisher(self._loop, self._publisher, self._streams)
        files = BoardFiles(options.root.join())
        devices, journal = self._devices, self._journal
        around = Environment(devices, files, journal, self._streams, time, self._status, options.settings)
        self._manager = Manager(configs, around, leases)
        self._connections.begin(self._manager)
        self._windows: OpenWindows | None = None
        self._reads: LocalReads | None = None
        self._data_socket = DataSocket(
            self._loop, options.runtime_dir, self._purposes(), self._connections, self._turns, options.group
        )
        self._interrupts = InterruptWatch(
            self._loop, options.root, self._manager, self._publisher.interrupt, self._manager.note_error
        )
        self._status.begin(self._manager, self._interrupts)
        self._leases = LeaseWatch(self._loop, leases)
        parts = self._manager, self._streams, self._interrupts
        self._board = BoardWatch(self._devices.boot_id, self._devices.others, *parts, self._autoload)
        self._service = ServiceManager()
        self._reloader = Reloader(
            options, self._manager, self._service, self._files.thread.submit, self._loop.call_threadsafe,
            apply=self._renew,
            standing=partial(self._provisioner.standing, example=options.example),
            complete=self._with_channels,
        )  # fmt: skip
        self._dispatcher = Dispatcher(
            self._loop, self._sockets, self._services(), self._publisher, self._manager.note_error
        )
        self._sensors = SensorWatch(options.root, self._publisher.measured)

    def _renew(self, found: Reloaded) -> None:
        """Apply other settings to what they bound; what exceeds a limit already stays."""
        self._connections.renew(found.access)
        for part in (self._clients, self._uploads, self._streams, self._streams.memories, self._provisioner):
            part.limits = found.limits
        self._manager.leases.renew(found.limits.leases, found.limits.leases_each)

    def _services(self) -> Services:
        return Services(
            loop=self._loop,
            manager=self._manager,
            streams=self._streams,
            interrupts=self._interrupts,
            provisioner=self._provisioner,
            leases=self._leases,
            turns=self._turns,
            clients=self._clients,
            uploads=self._uploads,
            board=self._board,
            status=self._status.status,
            connections=self._connections,
            complete=self._with_channels,
            renew_config=self._reloader.renew,
            files=self._files,
            audits=AuditEvents(self._publisher, self._connections.gate),
        )

    # ---- life ---------------------------------------------------------------------

    def serve(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Bind, reconcile, serve. Returns after `stop()`. Raises CmError if it cannot begin."""
        try:
            self._bind()
            self._manager.start()  # what it finds out is logged with the status that tells it
            self._board.begin()
            if self._options.scrub:
                from cm.server.scrubbing import Scrubber

                Scrubber(self._loop, self._manager, self._files.thread, self._options.scrub).begin()
            self._loop.every(_TICK, self._tick)
            self._sockets.announce()
            self._service.ready()
            if self._service.interval is not None:  # from the loop, so that one that hangs is restarted
                self._loop.every(self._service.interval, self._service.alive)
            on_ready()
            self._loop.run()
        finally:
            self._close()

    def stop(self) -> None:
        """End; safe in a signal handler."""
        self._loop.stop()

    def reload(self) -> None:
        """Read schemas, settings and keys again; what runs goes on. Safe in a signal handler."""
        self._loop.call_threadsafe(self._reloader.begin)

    def _bind(self) -> None:
        self._loop.add_socket(self._authenticator.socket, self._authenticator.answer)
        self._sockets.bind_ipc()
        self._data_socket.open()
        for address in self._options.listen:
            bound = self._sockets.bind_tcp(address, self._options.security)
            _LOG.info("listening on %s, %s, %s", bound.pub, bound.sub, bound.req)
        self._sensors.start()
        self._loop.add_socket(self._sockets.pub, self._status.take_subscriptions)
        self._loop.add_socket(self._sockets.sub, self._dispatcher.on_message)
        self._loop.add_socket(self._sockets.req, self._dispatcher.on_request, foremost=True)

    def _autoload(self) -> None:
        if self._options.load and self._manager.state.config is None:
            self._manager.submit(ChangeMode(*self._options.load.partition("/")[::2]), why="as it was started to")

    def _close(self) -> None:
        self._service.stopping()
        registers = [part.close for part in (self._windows, self._reads) if part is not None]
        users = (self._uploads.close, self._streams.end, self._turns.close, self._interrupts.close)
        watches = (self._sensors.close, self._leases.close, self._files.close, self._board.close)
        board = (self._devices.lost, self._journal.close, self._sockets.close)
        last = (self._authenticator.close, self._context.term, self._loop.close, self._locks.release)
        for end in (self._manager.stop, self._data_socket.close, *registers, *users, *watches, *board, *last):
            try:
                end()
            except OSError as error:  # the others have their turn all the same
                _LOG.warning("at the end: %s", sentence(error))

    def _purposes(self) -> dict[Purpose, Serve]:
        """What a connection to the data socket is opened for, and who serves it."""
        streams = self._streams
        return {
            Purpose.READ: streams.open_local,
            Purpose.WRITE: streams.open_local,
            Purpose.TRANSFER: streams.open_local,
            Purpose.ECHO: streams.memories.open,
            Purpose.ALLOCATE: streams.memories.open,
            Purpose.WINDOW: self._open_window,
            Purpose.WRITABLE_WINDOW: self._open_window,
            Purpose.REGISTERS: self._open_reads,
        }

    def _open_reads(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        if self._reads is None:
            from cm.server.local_reads import LocalReads

            self._reads = LocalReads(self._loop, self._manager, self._turns)
        self._reads.open(connection, wanted, peer)

    def _open_window(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        """Lend registers to a client of the data socket; nothing of it is there before one asks."""
        if self._windows is None:
            from cm.server.window_clients import OpenWindows

            self._windows = OpenWindows(self._loop, self._manager, self._devices, self._connections)
            self._status.at_rest = self._windows.ask_again
        self._windows.open(connection, wanted, peer)

    # ---- regular work ---------------------------------------------------------------------

    def _tick(self) -> None:
        self._manager.flush()
        self._streams.refresh()
        self._reloader.continue_waiting()
        self._reloader.poll()
        self._connections.end_expired()
        self._board.poll()
        self._uploads.forget_old()
        self._clients.settle()
        self._connections.settle()
        self._publisher.settle()
        if self._streams.any_open:
            self._status.publish()
