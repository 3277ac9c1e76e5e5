# SPDX-License-Identifier: Apache-2.0
"""The harness as a child process: requests that wait for their answer, and events that come in between."""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import select
import signal
import socket
import struct
import subprocess
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import NoReturn

from cm.frozen import dataclass
from cm.simulation.rtl.errors import RtlError

_HEAD = struct.Struct("=IIQQQQ")
TEXT = 32768
ANSWER = 128
ARENA_BYTES = 1 << 32
EXCHANGE = 32 << 20  # the place in the arena where bytes of memory are exchanged


class Op(IntEnum):
    """What a message is about; requests up to `TRY`, then events."""

    READ = 1
    WRITE = 2
    SEND = 3
    RECEIVE = 4
    CANCEL = 5
    LOAD = 6
    UNDEFINE = 7
    EMPTY = 8
    CONFIGURE = 9
    RESET = 10
    TRACE = 11
    MARK = 12
    STATE = 13
    TRY = 14
    SENT = 64
    RECEIVED = 65
    INTERRUPT = 66
    OUTPUT = 67
    STOPPED = 68
    FETCH = 72
    STORE = 73


@dataclass(frozen=True, slots=True)
class Message:
    """Four numbers and a text, by the meaning of `op` (harness/messages.h)."""

    op: int
    id: int = 0
    a: int = 0
    b: int = 0
    c: int = 0
    d: int = 0
    text: str = ""

    def pack(self) -> bytes:
        """As it travels."""
        return _HEAD.pack(self.op, self.id, self.a, self.b, self.c, self.d) + self.text.encode()[:TEXT]

    @classmethod
    def unpack(cls, data: bytes) -> Message:
        """From what came."""
        op, number, a, b, c, d = _HEAD.unpack_from(data)
        return cls(op, number, a, b, c, d, data[_HEAD.size :].decode(errors="replace"))


FAREWELL = 2.0  # seconds for its own end
PATIENCE = 60.0  # seconds for an answer: an access that the logic never answers is abandoned long before

Exchange = Callable[[bool, int, int], bool]  # write or read, address, bytes: by the arena; False: there is none


def _no_memory(write: bool, address: int, length: int) -> bool:  # noqa: ARG001 - an Exchange
    return False


class HarnessProcess:
    """A running harness; its memory is `arena`. If it ends, this and all later requests raise RtlError."""

    def __init__(self, program: Path, wiring: Path) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # Frames lie in memory that both map; only messages about them go through the socket.
        memory = os.memfd_create("cm-rtl-arena", os.MFD_CLOEXEC)
        os.ftruncate(memory, ARENA_BYTES)
        self.arena = mmap.mmap(memory, ARENA_BYTES)
        self.events: deque[Message] = deque()
        self.memory: Exchange = _no_memory
        self._socket = ours
        self._next = 1
        self._ended = ""
        ours.setblocking(False)
        with theirs:
            self._process = _start(program, wiring, theirs.fileno(), memory)
        os.close(memory)
        self._await(0)  # it says when it is ready

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    @property
    def ended(self) -> str:
        """Why it has ended; empty while it runs."""
        return self._ended

    def fileno(self) -> int:
        """Readable when an event is there."""
        return self._socket.fileno()

    def ask(self, op: Op, a: int = 0, b: int = 0, c: int = 0, d: int = 0, text: str = "") -> Message:
        """A request and its answer, whose `a` is an errno or 0."""
        if self._ended:
            raise RtlError(self._ended)
        number = self._next
        self._next = self._next % 0xFFFF_FFFF + 1
        try:
            self._socket.send(Message(op, number, a, b, c, d, text).pack())
        except OSError as error:
            self._end(str(error))
        return self._await(number)

    def take(self) -> list[Message]:
        """The events that are there."""
        with contextlib.suppress(RtlError, BlockingIOError):
            while True:
                message = self._receive()
                if not self._exchanged(message):
                    self.events.append(message)
        found = list(self.events)
        self.events.clear()
        return found

    def close(self) -> None:
        """End it."""
        self._socket.close()
        try:
            self._process.wait(FAREWELL)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        with contextlib.suppress(BufferError):  # a view of it is still in use
            self.arena.close()

    def _exchanged(self, message: Message) -> bool:
        """Answer the logic's memory accesses at once, since it waits for them."""
        if message.op not in (Op.FETCH, Op.STORE):
            return False
        there = self.memory(message.op == Op.STORE, message.a, message.b)
        self._socket.send(Message(message.op | ANSWER, a=0 if there else errno.EFAULT).pack())
        return True

    def _await(self, number: int) -> Message:
        while True:
            if not select.select([self._socket], [], [], PATIENCE)[0]:
                self._end(f"the harness did not answer for {PATIENCE:g} s")
            message = self._receive()
            if self._exchanged(message):
                continue
            if message.op & ANSWER and message.id == number:
                return message
            self.events.append(message)

    def _receive(self) -> Message:
        try:
            data = self._socket.recv(TEXT + 64)
        except BlockingIOError:
            raise
        except OSError as error:
            self._end(str(error))
        if not data:
            self._end("the harness ended")
        return Message.unpack(data)

    def _end(self, why: str) -> NoReturn:
        self._process.kill()
        status = self._process.wait()
        if status < 0 and status != -signal.SIGKILL:
            why += f" by {signal.Signals(-status).name}"
        self._ended = f"the logic does not run any more: {why}"
        raise RtlError(self._ended)


def _start(program: Path, wiring: Path, theirs: int, memory: int) -> subprocess.Popen[bytes]:
    """The harness with its end of the socket and the memory; what it prints goes to our standard error."""
    command = [str(program), str(wiring), str(theirs), str(memory)]
    try:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=2, pass_fds=(theirs, memory))
    except OSError as error:
        raise RtlError(f"{program} does not start: {error}") from None
