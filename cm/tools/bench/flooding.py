# SPDX-License-Identifier: Apache-2.0
"""A client that makes as many requests as it can, in every way at once, of a manager on this machine.

``python -m cm.tools.bench.flooding RUNTIME_DIR``: prints ``flooding`` once each way is under way, goes on in rounds
until its input ends, and then prints the outcome of its requests, as JSON.
"""

from __future__ import annotations

import json
import select
import socket
import sys
from collections import Counter
from contextlib import ExitStack, suppress
from itertools import count
from pathlib import Path
from typing import Any

import zmq

from cm.client.board import Board
from cm.errors import CmError
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.plane_packets import (
    DESCRIPTOR,
    LEAVE,
    PACKET_MAX,
    PING,
    READ,
    RELEASE,
    SOCKET,
    SUBMIT,
    Descriptor,
    Open,
    Purpose,
    encode_open,
)  # fmt: skip

ROUNDS = 400  # at most
MIB = 1 << 20
_CONNECTIONS = 100  # that request the status again and again
_IDLE = 100
_TOPICS = 900
_UNREAD = 4
_KINDS = (RELEASE, SUBMIT, PING, LEAVE)  # packets of the data socket; OPEN is said once on a connection
_PACKETS = 500
_READERS = 8
_TEXTS = (b"{" * 60_000, b"{'a':" + b"9" * 60_000 + b"}", b"\xff" * 100_000, b"{" + b"'a':1," * 10_000 + b"}")
_PATIENCE = 60_000  # milliseconds until an answer counts as missing


class Flood:
    """One process's."""

    def __init__(self, runtime: Path, stack: ExitStack) -> None:
        self._runtime = runtime
        self._stack = stack
        self._context = stack.enter_context(zmq.Context())
        self._context.set(zmq.MAX_SOCKETS, 2048)
        self._numbers = count()
        self.codes = Counter[str]()
        self.asked = 0
        self._idle = [self._plain() for _ in range(_IDLE)]
        self._many = [self._dealer() for _ in range(_CONNECTIONS)]
        self._one = self._dealer()
        self._unread = [self._dealer(unread=True) for _ in range(_UNREAD)]
        self._subscriber = self._socket(zmq.SUB, "pub")
        for number in range(_TOPICS):
            self._subscriber.setsockopt(zmq.SUBSCRIBE, b"cm_nothing/%d" % number)
        self._board = stack.enter_context(Board(runtime_dir=runtime, timeout=_PATIENCE / 1000))
        self._greedy = stack.enter_context(self._board.stream("camera", depth=255))
        self.packets = 0
        self._planes = {kind: self._echo() for kind in _KINDS}
        self._reads = [self._reader() for _ in range(_READERS)]

    def _socket(self, kind: int, name: str) -> Any:
        made = self._stack.enter_context(self._context.socket(kind))
        made.linger = 0
        made.setsockopt(zmq.SNDHWM, 0)
        made.connect(f"ipc://{self._runtime}/{name}")
        return made

    def _dealer(self, unread: bool = False) -> Any:
        made = self._context.socket(zmq.DEALER)
        self._stack.callback(made.close, 0)
        made.setsockopt(zmq.SNDHWM, 0)
        made.setsockopt(zmq.RCVHWM, 1 if unread else 0)
        if unread:
            made.setsockopt(zmq.RCVBUF, 4096)
        made.connect(f"ipc://{self._runtime}/req")
        return made

    def _plain(self) -> socket.socket:
        """A connection that sends nothing; the manager closes it after ten seconds, as it should."""
        made = self._stack.enter_context(socket.socket(socket.AF_UNIX))
        made.connect(str(self._runtime / "req"))
        return made

    def _plane(self, wanted: Open) -> socket.socket:
        """A connection to the data socket that says what it wants."""
        made = self._stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        made.connect(str(self._runtime / SOCKET))
        made.send(encode_open(wanted))
        return made

    def _echo(self) -> tuple[socket.socket, int]:
        """One that has memory, with its epoch."""
        made = self._plane(Open("", Purpose.ECHO, length=4096, depth=1))
        epoch = Descriptor(*DESCRIPTOR.unpack_from(made.recv(PACKET_MAX))).flags
        made.setblocking(False)
        return made, epoch

    def _reader(self) -> socket.socket:
        """One that reads registers by name."""
        made = self._plane(Open("", Purpose.REGISTERS))
        made.recv(PACKET_MAX)
        made.setblocking(False)
        return made

    def begin(self) -> None:
        """Begin with the requests that are made once, whose answers are not read."""
        for dealer in self._unread:
            for request in (rq.ReadConfig(), rq.ReadData("camera"), rq.ReadStatus(clients=True)):
                for _ in range(20):
                    dealer.send_multipart(encode_request(request))

    def round(self) -> None:
        """Make requests in every way, then read the answers."""
        asking = [*self._leases(), *self._uploads(), *self._long(), *self._texts()]
        for frames in asking:
            self._one.send_multipart(frames)
        status = encode_request(rq.ReadStatus())
        for dealer in self._many:
            for _ in range(4):
                dealer.send_multipart(status)
        for kind in _KINDS:
            self._packets(kind)
        for number in range(_READERS):
            self._read_names(number)
        for _ in range(4):  # who opens what there is not, and hangs up
            self._plane(Open("none")).close()
        with suppress(CmError):
            self._greedy.read(timeout=0.0)
        self._read(self._one, len(asking))
        for dealer in self._many:
            self._read(dealer, 4)

    def _packets(self, kind: int) -> None:
        """One kind of packet again and again, as many as the manager takes; what it says to that is not looked at."""
        plane, epoch = self._planes[kind]
        if not self._poured(plane, [Descriptor(kind=kind, slot=7, flags=epoch).pack()] * _PACKETS):
            self._planes[kind] = self._echo()

    def _read_names(self, number: int) -> None:
        """Names that there are, and that there are not, again and again."""
        reads = [Descriptor(kind=READ).pack() + name for name in (b"led", b"none")]
        if not self._poured(self._reads[number], reads * (_PACKETS // 2)):
            self._reads[number] = self._reader()

    def _poured(self, connection: socket.socket, packets: list[bytes]) -> bool:
        """Send as many as the manager takes; False if it hung up, because this end did not read as fast as it sent."""
        try:
            for packet in packets:
                connection.send(packet)
                self.packets += 1
                with suppress(BlockingIOError):
                    while connection.recv(PACKET_MAX):
                        pass
        except BlockingIOError:
            pass
        except OSError:
            connection.close()
            return False
        return True

    def _leases(self) -> list[Any]:
        return [encode_request(rq.TakeLease("registers:zoom", exclusive=False, seconds=5.0)) for _ in range(40)]

    def _uploads(self) -> list[Any]:
        names = [f"flood {next(self._numbers)}" for _ in range(8)]
        parts = [encode_request(rq.Upload(name, 4 * MIB, offset=0, data=bytes(MIB))) for name in names]
        return parts + [encode_request(rq.Upload(name, 4 * MIB, discard=True)) for name in names[:6]]

    def _long(self) -> list[Any]:
        writes = tuple(rq.RegWrite("led", number % 4) for number in range(1024))
        return [encode_request(rq.WriteReg(writes)), encode_request(rq.ReadReg())]

    def _texts(self) -> list[Any]:
        return [[b"cm_write_reg", text] for text in _TEXTS]

    def _read(self, dealer: Any, answers: int) -> None:
        self.asked += answers
        for _ in range(answers):
            if not dealer.poll(_PATIENCE):
                return
            error = decode_reply(dealer.recv_multipart()).error
            self.codes[error.code if error else "ok"] += 1


def main(runtime: str) -> None:
    """Flood until the input ends."""
    with ExitStack() as stack:
        flood = Flood(Path(runtime), stack)
        flood.begin()
        rounds = 0
        for rounds in range(1, ROUNDS + 1):
            flood.round()
            if rounds == 1:
                print("flooding", flush=True)
            if select.select([sys.stdin], [], [], 0)[0]:
                break
        else:
            sys.stdin.read()
        told = {"rounds": rounds, "asked": flood.asked, "answered": sum(flood.codes.values())}
        print(json.dumps({**told, "codes": flood.codes, "packets": flood.packets}))


if __name__ == "__main__":
    main(*sys.argv[1:])
