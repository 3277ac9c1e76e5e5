# SPDX-License-Identifier: Apache-2.0
"""The clients of the data socket that read registers by name, answered by a C thread without the loop.

The thread has a table of names. The manager withdraws it wherever a name may lead elsewhere; it is published again, in
steps of the loop, once a client asks for what is not in it. Who gets no value from the thread asks by a request.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator

from cm.device.register_reads import RegisterReads
from cm.errors import CmError
from cm.loop import Timer
from cm.manager.manager import Manager
from cm.server.client_process import Peer
from cm.server.long_work import RoundRobin
from cm.server.sockets import Loop
from cm.wire.plane_packets import Open

_AT_ONCE = 32  # registers that are published in one step
_REST = 3.0  # pause before the next publication, as a multiple of the time that the last one took
_SHORTEST = 0.002  # the shortest such pause, in seconds


class LocalReads:
    """Everything in the loop's thread."""

    def __init__(self, loop: Loop, manager: Manager, turns: RoundRobin) -> None:
        self._loop = loop
        self._manager = manager
        self._turns = turns
        self._reads = RegisterReads()
        self._publishing = False  # or at rest after that
        self._again = False  # something was wanted meanwhile
        self._resting: Timer | None = None
        manager.publish_to(self._reads)
        loop.add(self._reads.fileno(), self._wanted)

    def open(self, connection: socket.socket, _: Open, peer: Peer) -> None:
        """Serve a connection; the caller closes its own copy. Raises DeviceBusy for one too many."""
        fd = os.dup(connection.fileno())
        try:
            self._reads.adopt(fd, peer.uid)
        except BaseException:
            os.close(fd)
            raise

    def _wanted(self) -> None:
        self._reads.take()
        if self._publishing:
            self._again = True
        else:
            self._publish()

    def _publish(self) -> None:
        self._publishing, self._again = True, False
        self._turns.run(self._offered())

    def _offered(self) -> Iterator[None]:
        """Offer all registers in these steps, each what is true then; a change of mode between them withdraws all."""
        registers, took = self._manager.registers, 0.0
        names = tuple(registers.visible_names())
        for first in range(0, len(names), _AT_ONCE):
            began = time.monotonic()
            try:
                registers.offer(names[first : first + _AT_ONCE], self._reads)
            except CmError:  # nothing is loaded any more, or a read hangs
                break
            took += time.monotonic() - began
            yield
        self._resting = self._loop.call_later(max(_SHORTEST, _REST * took), self._rested)

    def _rested(self) -> None:
        self._resting, self._publishing = None, False
        if self._again:
            self._publish()

    def close(self) -> None:
        """Hang up on all."""
        if self._resting is not None:
            self._resting.cancel()
        self._loop.remove(self._reads.fileno())
        self._reads.close()
