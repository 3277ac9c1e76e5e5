# SPDX-License-Identifier: Apache-2.0
"""The clients of the data socket that have registers mapped, or wait for a module whose registers they may map.

Each has a connection of its own: its end gives the pages back, and over it the client is told when they were taken.
"""

from __future__ import annotations

import logging
import os
import socket
from contextlib import suppress
from functools import partial

from cm.errors import Busy, CmError
from cm.manager.access.register_windows import Loan, WindowRequest
from cm.manager.errors import HeldBy, ModuleAbsent, NothingLoaded, RegionBusy
from cm.manager.manager import Manager
from cm.server.client_process import Peer
from cm.server.connections import Connections
from cm.server.devices import BoardDevices
from cm.server.sockets import Loop
from cm.wire.encode import encoded
from cm.wire.plane_packets import Open, Purpose, WindowPages, encode_refused, encode_revoked, encode_window

_LOG = logging.getLogger("cm")
EACH, MOST = 48, 64  # windows of one user, and of all: each is taken back before a change goes on
_NOT_YET = (ModuleAbsent, NothingLoaded, RegionBusy, HeldBy)  # what may be over after a change of mode


class _Client:
    """A connection, and what it has or waits for."""

    def __init__(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        self.connection, self.wanted, self.peer = connection, wanted, peer
        self.loan: Loan | None = None


class OpenWindows:
    """Everything in the loop's thread."""

    def __init__(self, loop: Loop, manager: Manager, devices: BoardDevices, rights: Connections) -> None:
        self._loop = loop
        self._manager = manager
        self._devices = devices
        self._rights = rights
        self._clients: list[_Client] = []
        self._watched = -1  # the lender's descriptor

    def open(self, connection: socket.socket, wanted: Open, peer: Peer) -> None:
        """Lend what a connection wants, or let it wait; the caller closes its own copy. Raises what refuses it."""
        if sum(c.peer.uid == peer.uid for c in self._clients) >= EACH or len(self._clients) >= MOST:
            raise Busy(f"a user has at most {EACH} windows, all together {MOST}; give one back")
        client = _Client(connection.dup(), wanted, peer)
        self._clients.append(client)
        # It hangs up, or breaks the rules: there is nothing to be said over such a connection.
        self._loop.add(client.connection.fileno(), partial(self._forget, client))
        try:
            self._try(client)
        except BaseException:
            self._forget(client)
            raise

    def _try(self, client: _Client) -> None:
        try:
            self._lend(client)
        except _NOT_YET:
            if not client.wanted.wait:
                raise

    def _lend(self, client: _Client) -> None:
        wanted, peer = client.wanted, client.peer
        name = f"pid {peer.pid} ({peer.name})"
        writes = wanted.purpose is Purpose.WRITABLE_WINDOW
        request = WindowRequest(wanted.name, writes, wanted.exclusive, wanted.lease, name, peer.pid)
        loan, fd = self._manager.windows.lend(request, self._devices, partial(self._ended, client))
        client.loan = loan
        self._watch()
        table = os.memfd_create("cm-registers", os.MFD_CLOEXEC)
        try:
            os.write(table, encoded(loan.info))
            place = loan.place
            names = loan.status.region, place.module, place.config.name, place.mode, loan.lease
            packet = encode_window(WindowPages(place.address, place.length, writes, *names))
            socket.send_fds(client.connection, [packet], [fd, table], socket.MSG_NOSIGNAL)
            _LOG.info("registers of %s mapped by %s", place.module or loan.status.region, name)
        finally:
            os.close(fd)
            os.close(table)

    def ask_again(self) -> None:
        """A change has ended: those that wait may get theirs."""
        for client in [client for client in self._clients if client.loan is None]:
            try:
                self._rights.check_open(self._rights.whose(client.connection), client.wanted)
                self._try(client)
            except (CmError, OSError) as error:
                with suppress(OSError):
                    code = error.code if isinstance(error, CmError) else "device_error"
                    client.connection.send(encode_refused(code, str(error)), socket.MSG_NOSIGNAL)
                self._forget(client)

    def _forget(self, client: _Client) -> None:
        if client not in self._clients:
            return
        self._clients.remove(client)
        self._loop.remove(client.connection.fileno())
        client.connection.close()
        if client.loan is not None:
            written = self._manager.windows.give_back(client.loan.number)
            if written is not None:
                self._manager.tell_registers(written)

    def _ended(self, client: _Client, reason: int, config: str, mode: str) -> None:
        """Its pages were taken back. Any thread."""
        self._loop.call_threadsafe(lambda: self._tell(client, encode_revoked(reason, config, mode)))

    def _tell(self, client: _Client, packet: bytes) -> None:
        if client in self._clients:
            with suppress(OSError):  # it has gone, or reads nothing
                client.connection.send(packet, socket.MSG_NOSIGNAL)
            self._forget(client)

    def _watch(self) -> None:
        """Look after what the kernel takes back by itself."""
        if self._watched < 0:
            self._watched = self._manager.windows.fileno()
            self._loop.add(self._watched, self._collect)
            self._manager.windows.closing = self._unwatch

    def _collect(self) -> None:
        try:
            self._manager.windows.collect()
        except OSError:  # the board is gone, which is found out elsewhere
            self._unwatch()

    def _unwatch(self) -> None:
        if self._watched >= 0:
            self._loop.remove(self._watched)
        self._watched = -1

    def close(self) -> None:
        """Hang up on all."""
        for client in list(self._clients):
            self._forget(client)
        self._unwatch()
