# SPDX-License-Identifier: Apache-2.0
"""Registers read over the manager's data socket, which its C thread answers: no ZeroMQ, and no turn of its loop.

A read that cannot be made this way, for whatever reason, is made by a request, which also says what is wrong. So
nothing here raises, and whoever uses it needs to know nothing of it.
"""

from __future__ import annotations

import os
import socket
import struct
import threading
import time
import weakref
from collections.abc import Sized
from contextlib import suppress
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import get_ident

from cm.client.after_fork import not_for_children
from cm.client.data_socket import LIMITS_ARE_KNOWN, connect, limit
from cm.client.errors import BoardClosed
from cm.errors import CmError
from cm.wire.plane_packets import DESCRIPTOR, NAME_MAX, PACKET_MAX, READ, REGISTERS, VALUE, Open, Purpose, encode_open

_SHORTEST, _LONGEST = 0.01, 30.0  # seconds until the next attempt after one that failed, twice as many each time
_SKIPPED = 63  # reads of a name, at most, that are not tried after some that led elsewhere
_NAMES = 1024  # of which that is remembered
# as plain numbers: operators of the enumerations they come from cost more than the system call
_FLAGS = int(socket.MSG_DONTWAIT) | int(socket.MSG_NOSIGNAL)
_DONTWAIT = int(socket.MSG_DONTWAIT)
_unpack = struct.Struct("=2xB5xQQ8x").unpack  # of a descriptor its kind, length and sequence
# Bytes; what follows says why there is no value, which the request that is made then says too.
_ANSWER = DESCRIPTOR.size

_Questions = dict[str, tuple[bytes, int]]  # by name, with their numbers
_Turn = tuple[socket.socket, _Questions]


class LocalReads:
    """One connection; threads take turns.

    There is one turn, and who has it reads. It comes back after an answer, and the same question can be asked again.
    Where none came, a new turn takes its place, whose questions have other numbers, so that an answer that comes too
    late is to none of them.
    """

    def __init__(self, folder: Path, unanswered: Sized, patience: float) -> None:
        """`unanswered`: requests of this client that may still take effect, behind which a read would have to wait.

        `patience`: seconds that a read may take until it is made by a request instead.
        """
        self._folder, self._unanswered, self._patience = folder, unanswered, patience
        self._process = os.getpid()
        self._beginning = threading.RLock()  # again for a signal handler in a thread that has it
        self._numbers = count(1)
        self._socket: socket.socket | None = None
        self._ready: SimpleQueue[_Turn] | None = None  # holds the turn; None: the connection cannot be used
        self._reader = 0  # the thread that has the turn, or had it last
        self._admitted = self._over = False
        self._pause, self._until = _SHORTEST, 0.0  # nothing is tried before that time
        self._missed: dict[str, tuple[int, int]] = {}  # names that led elsewhere: reads to skip, left and in all
        not_for_children(self)

    def read(self, name: str) -> int | None:
        """What a register or field holds; None if it has to be asked for."""
        ready = self._ready or self._begin()
        if ready is None or self._unanswered:
            return None
        value: int | None
        try:
            try:
                turn = ready.get_nowait()
            except Empty:
                waited = self._await(ready)
                if waited is None:
                    return None
                turn = waited
            self._reader = get_ident()
            sock, questions = turn
            try:
                packet, number = questions[name]
            except KeyError:
                question = self._question(name)
                if question is None:
                    ready.put(turn)
                    return None
                packet, number = questions[name] = question
            sock.send(packet, _FLAGS)
            kind, value, answered = _unpack(sock.recv(_ANSWER))
            while answered != number:  # others came too late
                kind, value, answered = _unpack(sock.recv(_ANSWER))
            if kind != VALUE:
                self._miss(name, questions)
                value = None
            ready.put(turn)
        except (BlockingIOError, TimeoutError):  # the latter where LIMITS_ARE_KNOWN is False
            self._late()
            return None
        except (OSError, struct.error):  # hung up on, or closed by another thread
            self._hang_up()
            return None
        except BaseException:  # of a signal handler: the turn may be lost
            self._ready = None
            raise
        return value

    def _await(self, ready: SimpleQueue[_Turn]) -> _Turn | None:
        """The turn, as soon as another thread gives it back; None if none does in time."""
        if self._reader == get_ident():  # a signal handler's read within a read, which goes on after it
            return None
        try:
            return ready.get(timeout=self._patience)
        except Empty:
            self._ready = None
            return None

    def _question(self, name: str) -> tuple[bytes, int] | None:
        """With a number that none had before; None for a name that has to be asked for."""
        if name in self._missed and self._skips(name):
            return None
        try:
            text = name.encode()
        except (AttributeError, UnicodeEncodeError):  # no name at all
            return None
        if len(text) > NAME_MAX:
            return None
        number = next(self._numbers)
        return DESCRIPTOR.pack(0, READ, 0, 0, 0, number, 0) + text, number

    def _skips(self, name: str) -> bool:
        left, most = self._missed[name]
        if left:
            self._missed[name] = left - 1, most
        return left > 0

    def _miss(self, name: str, questions: _Questions) -> None:
        """It led elsewhere, for now or always: it is tried more seldom each time."""
        del questions[name]
        most = self._missed.get(name, (0, 0))[1]
        if len(self._missed) >= _NAMES:
            self._missed.clear()
        self._missed[name] = (min(2 * most + 1, _SKIPPED),) * 2

    # ---- the connection ------------------------------------------------------------------------

    def _begin(self) -> SimpleQueue[_Turn] | None:
        """Take the next step towards a connection that can be used; never waits."""
        if self._over or time.monotonic() < self._until:
            return None
        with self._beginning:
            try:
                sock = self._socket
                if sock is None:
                    self._open()
                elif self._ready is None and (self._admitted or self._is_admitted(sock)):
                    self._ready = _first_turn(sock)
            except BlockingIOError:  # not yet
                pass
            except (CmError, OSError, struct.error):
                self._hang_up()
        return self._ready

    def _open(self) -> None:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        try:
            connect(sock, self._folder)
            sock.send(encode_open(Open("", Purpose.REGISTERS)), _FLAGS)
        except BlockingIOError:  # others connect without end
            sock.close()
            self._rest()
            return
        except BaseException:
            sock.close()
            raise
        weakref.finalize(self, sock.close)
        self._socket = sock
        if self._over:  # meanwhile
            self._hang_up()

    def _is_admitted(self, sock: socket.socket) -> bool:
        """Raises BlockingIOError as long as there is no answer."""
        _, kind, *_ = DESCRIPTOR.unpack_from(sock.recv(PACKET_MAX, _DONTWAIT))
        if kind != REGISTERS:
            raise OSError("refused, as by a manager that has no such reads")
        sock.settimeout(None if LIMITS_ARE_KNOWN else self._patience)
        if LIMITS_ARE_KNOWN:
            limit(sock, self._patience)
        self._admitted = True
        return True

    def _late(self) -> None:
        """No answer in time: a bus that hangs, or a machine that is too busy."""
        self._ready = None
        self._rest()

    def _hang_up(self) -> None:
        sock, self._socket, self._ready = self._socket, None, None
        self._admitted = False
        self._missed.clear()
        if sock is not None:
            sock.close()
        self._rest()

    def _rest(self) -> None:
        now = time.monotonic()
        soon = now - self._until < 10 * self._pause  # after the attempt before
        self._pause = min(2 * self._pause, _LONGEST) if soon else _SHORTEST
        self._until = now + self._pause

    # ---- its end -------------------------------------------------------------------------------

    def end(self, _: BoardClosed) -> None:
        """Hang up for good; a thread that waits for an answer makes a request, which says why."""
        self._over = True
        sock = self._socket
        if sock is not None and os.getpid() == self._process:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._hang_up()

    def disown(self) -> None:
        """This process was forked: the connection is its parent's, and its board says so."""
        self._over = True
        self._hang_up()


def _first_turn(sock: socket.socket) -> SimpleQueue[_Turn]:
    ready: SimpleQueue[_Turn] = SimpleQueue()
    ready.put((sock, {}))
    return ready
