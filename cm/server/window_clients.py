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
from cm.frozen import dataclass
from cm.manager.access.register_windows import Loan, WindowRequest
from cm.manager.errors import HeldBy, ModuleAbsent, NothingLoaded, RegionBusy
from cm.manager.manager import Manager
from cm.server.client_process import Peer
from cm.server.connections import Connections
from cm.server.devices import BoardDevices
from cm.server.error_replies import encode_refusal
from cm.server.sockets import Loop
from cm.wire.encode import encoded
from cm.wire.plane_packets import Open, Purpose, WindowPages, encode_revoked, encode_window

_LOG = logging.getLogger("cm")
EACH, MOST = 48, 64  # windows of one user, and of all: each is taken back before a change goes on
_NOT_YET = (ModuleAbsent, NothingLoaded, RegionBusy, HeldBy)  # what may be over after a change of mode


@dataclass(slots=True, eq=False)
class _Client:
    """A connection, and what it has or waits for."""

    connection: socket.socket
    wanted: Open
    peer: Peer
    loan: Loan | None = None


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
            self._lend(client)
        except BaseException:
            self._forget(client)
            raise

    def _lend(self, client: _Client) -> None:
        """Lend what it wants, if that is there; if it waits, it may get it later."""
        wanted, peer = client.wanted, client.peer
        name = f"pid {peer.pid} ({peer.name})"
        writes = wanted.purpose is Purpose.WRITABLE_WINDOW
        request = WindowRequest(wanted.name, writes, wanted.exclusive, wanted.lease, name, peer.pid)
        try:
            loan, fd = self._manager.windows.lend(request, self._devices, partial(self._taken_back, client))
        except _NOT_YET:
            if not wanted.wait:
                raise
            return
        client.loan = loan
        if self._watched < 0:  # what the kernel takes back by itself is to be noticed
            self._watched = self._manager.windows.fileno()
            self._loop.add(self._watched, self._collect)
            self._manager.windows.closing = self._unwatch
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
                self._lend(client)
            except (CmError, OSError) as error:
                with suppress(OSError):
                    client.connection.send(encode_refusal(error), socket.MSG_NOSIGNAL)
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

    def _taken_back(self, client: _Client, reason: int, config: str, mode: str) -> None:
        """Its pages were taken back. Any thread."""

        def hang_up() -> None:
            if client in self._clients:
                with suppress(OSError):  # it has gone, or reads nothing
                    client.connection.send(encode_revoked(reason, config, mode), socket.MSG_NOSIGNAL)
                self._forget(client)

        self._loop.call_threadsafe(hang_up)

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
