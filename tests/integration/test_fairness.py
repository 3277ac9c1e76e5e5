# SPDX-License-Identifier: Apache-2.0
"""Requests are served by clients in turn, not by connections: the order is asserted, as the manager has it."""

from __future__ import annotations

import socket
import statistics
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import zmq
from manager_process import CAMERA, environment, short_folder, until

import cm
from cm.device import Root
from cm.schema import load_folder
from cm.server import server as daemon
from cm.server.intake import Intake
from cm.server.limits import MIB, Limits
from cm.server.options import Options
from cm.server.shares.budget import Budget
from cm.server.shares.places import Places
from cm.simulation.software import Board as SimBoard
from cm.wire.bounds import SLICE
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages.requests import ReadStatus, RegWrite, WriteReg
from cm.wire.messages.status import Reply
from cm.wire.plane_packets import Open, encode_open

CONNECTIONS, EACH = 200, 40
ECHO = encode_open(Open("", echo=True, length=4096, depth=1))

# Opens connections, sends requests over each of them when told to, and reads all answers.
HOSTILE = """
import sys, zmq
folder, connections, each = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
context = zmq.Context()
context.set(zmq.MAX_SOCKETS, 4096)
made = [context.socket(zmq.DEALER) for _ in range(connections)]
for socket in made:
    socket.linger = 0
    socket.connect(f"ipc://{folder}/req")
    socket.send_multipart([b"", b"cm_status", b""])
for socket in made:
    socket.recv_multipart()
print("ready", flush=True)
sys.stdin.readline()
for _ in range(each):
    for socket in made:
        socket.send_multipart([b"", b"cm_status", b""])
print("sent", flush=True)
for socket in made:
    for _ in range(each):
        code = bytes(socket.recv_multipart()[2])
print("answered", flush=True)
sys.stdin.readline()
"""


class Order:
    """The order in which clients were served; the cost of a request is set here and not measured."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.served: list[str] = []
        self.beside: list[bool] = []  # whether others were waiting then
        self.cost: dict[str, int] = {}  # nanoseconds of a request
        self.usual = 1000
        self._now = 0
        serve = Intake._serve
        patch.setattr("cm.server.intake.monotonic_ns", lambda: self._now)

        def noted(intake: Intake, budget: Budget, began: int, *call: Any) -> Any:
            self.served.append(budget.name)
            self.beside.append(any(other is not budget for other in intake._turns._there))
            self._now = began + self.cost.get(budget.name, self.usual)
            return serve(intake, budget, began, *call)

        patch.setattr(Intake, "_serve", noted)

    def clear(self) -> None:
        self.served.clear()
        self.beside.clear()

    def passed_over(self, name: str) -> int:
        """How often that client was served twice in a row while others waited."""
        twice = pairwise(zip(self.served, self.beside, strict=True))
        return sum(one == other == name and waited for (one, waited), (other, _) in twice)

    def between(self, name: str) -> list[int]:
        """How many others were served between two requests of that client."""
        at = [i for i, served in enumerate(self.served) if served == name]
        return [after - before - 1 for before, after in pairwise(at)]


@pytest.fixture
def order(monkeypatch: pytest.MonkeyPatch) -> Order:
    return Order(monkeypatch)


@contextmanager
def serving(limits: Limits = Limits(), **options: Any) -> Iterator[tuple[daemon.Server, Path]]:  # noqa: B008
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        made = Options(
            folder / "run",
            folder / "s",
            Root.of(sim.root),
            load_folder(CAMERA),
            load="camera",
            limits=limits,
            **options,
        )
        ready = threading.Event()
        server = daemon.Server(made)
        thread = threading.Thread(target=server.serve, args=(ready.set,))
        thread.start()
        try:
            assert ready.wait(60)
            yield server, made.runtime_dir
        finally:
            server.stop()
            thread.join()


@contextmanager
def hostile(runtime: Path, connections: int = CONNECTIONS, each: int = EACH) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-c", HOSTILE, str(runtime), str(connections), str(each)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment()) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            yield process
        finally:
            process.kill()


def tell(process: subprocess.Popen[bytes], wanted: bytes) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(b"\n")
    process.stdin.flush()
    assert process.stdout.readline() == wanted


@contextmanager
def held(server: daemon.Server) -> Iterator[None]:
    """Keep the loop from serving while messages come in."""
    holds, goes_on = threading.Event(), threading.Event()

    def hold() -> None:
        holds.set()
        goes_on.wait(60)

    server._loop.call_threadsafe(hold)
    assert holds.wait(60)
    try:
        yield
    finally:
        goes_on.set()


def asked(socket: zmq.Socket[bytes], count: int) -> None:
    for number in range(count):
        socket.send_multipart([b"%d" % number, b"", b"cm_status", b""])


def answered(socket: zmq.Socket[bytes], count: int) -> list[Reply]:
    replies = []
    for number in range(count):
        assert socket.poll(60_000)
        frames = socket.recv_multipart()
        assert frames[0] == b"%d" % number
        replies.append(decode_reply(frames[2:]))
    return replies


def test_200_connections_of_one_process_are_not_200_turns(order: Order, context: zmq.Context[Any]) -> None:
    with serving() as (server, runtime), hostile(runtime) as flood, context.socket(zmq.DEALER) as other:
        other.linger = 0
        other.connect(f"ipc://{runtime}/req")
        asked(other, 1)
        answered(other, 1)
        ours = order.served[-1]
        with held(server):
            tell(flood, b"sent\n")
            order.served.clear()
            asked(other, 50)
        assert all(reply.error is None for reply in answered(other, 50))
        assert order.served.count(ours) == 50
        # a round of 201 connections takes 7 turns of the loop, in each of which one request is served
        assert statistics.median(order.between(ours)) <= 16, order.between(ours)
        assert flood.stdout is not None
        assert flood.stdout.readline() == b"answered\n"  # no answer was lost
        assert len(order.served) == 50 + CONNECTIONS * EACH


def test_processes_of_another_account_take_turns_with_all_of_the_first(order: Order, context: zmq.Context[Any]) -> None:
    """Over TCP without keys a client belongs to another account than over ipc."""
    with (
        serving(listen=("tcp://127.0.0.1:0",)) as (server, runtime),
        hostile(runtime, 60, EACH) as one,
        hostile(runtime, 60, EACH) as two,
        context.socket(zmq.DEALER) as other,
    ):
        other.linger = 0
        other.connect(server._sockets.tcp[0].req)
        asked(other, 1)
        answered(other, 1)
        ours = order.served[-1]
        with held(server):
            tell(one, b"sent\n")
            tell(two, b"sent\n")
            order.served.clear()
            asked(other, 50)
        answered(other, 50)
        assert statistics.median(order.between(ours)) <= 16, order.between(ours)
        with cm.connect(runtime_dir=runtime, timeout=60) as board:
            accounts = {client.account for client in board.clients()}
        assert {"tcp:127.0.0.1"} < accounts
        assert len(accounts) == 2


def test_a_client_with_slow_requests_is_served_less_often(order: Order, context: zmq.Context[Any]) -> None:
    with serving() as (server, runtime), hostile(runtime, 20) as flood, context.socket(zmq.DEALER) as other:
        other.linger = 0
        other.connect(f"ipc://{runtime}/req")
        (mine,) = [client for client in told_clients(other) if client.name == order.served[-1]]
        order.cost = {mine.name: 1000}
        order.usual = 9000
        with held(server):
            tell(flood, b"sent\n")
            order.served.clear()
            asked(other, 50)
        answered(other, 50)
        between = order.between(mine.name)  # one other after nine; more if ours came in several batches
        assert max(between) > 0
        assert between.count(0) >= 36, between
        (now,) = [client for client in told_clients(other) if client.name == mine.name]
        assert now.requests == mine.requests + 51
        assert now.loop_seconds == pytest.approx(mine.loop_seconds + 51e-6)


def test_a_long_request_is_read_in_slices_and_others_have_their_turns_in_between(
    order: Order, context: zmq.Context[Any]
) -> None:
    """Later requests of the same sender wait until it has been decoded, even those that wait for nothing else."""
    with serving() as (server, runtime), hostile(runtime, 4, 40) as flood, context.socket(zmq.DEALER) as other:
        other.linger = 0
        other.connect(f"ipc://{runtime}/req")
        with cm.connect(runtime_dir=runtime, timeout=60) as board:
            board.load("camera", "default")
        (mine,) = [client for client in told_clients(other) if client.name == order.served[-1]]
        with held(server):
            tell(flood, b"sent\n")
            order.clear()
            writes = WriteReg(tuple(RegWrite("led", number % 4) for number in range(1024)))
            other.send_multipart([b"long", b"", *encode_request(writes)])
            other.send_multipart([b"status", b"", b"cm_status", b""])
        replies = [other.recv_multipart() for _ in range(2) if other.poll(60_000)]
        assert {bytes(reply[0]) for reply in replies} == {b"long", b"status"}
        assert [decode_reply(reply[2:]).error for reply in replies] == [None, None]
        assert (
            order.served.count(mine.name) == 1 + 1024 // SLICE + 1 + 1
        )  # its arrival, its slices, its end; the status
        assert order.passed_over(mine.name) <= 6, (order.served, order.beside)
        now = told_of(other, mine.name)
        assert (now.requests, now.waiting) == (mine.requests + 3, 0)
        until(lambda: told_of(other, mine.name).waiting_bytes == 0)  # libzmq reports later what it has sent


def test_a_client_that_keeps_opening_streams_waits_behind_others(order: Order) -> None:
    """Allocating slots or memory holds up the loop, so that is done by turns as well."""
    with (
        serving() as (server, runtime),
        hostile(runtime, 40) as flood,
        cm.connect(runtime_dir=runtime, timeout=60) as board,
        ExitStack() as opened,
    ):
        assert board.configs == ("camera",)
        ours = order.served[-1]
        data = [opened.enter_context(data_socket(runtime)) for _ in range(20)]
        until(lambda: len(server._acceptor._newcomers) == 20)
        with held(server):
            tell(flood, b"sent\n")
            order.served.clear()
            for connection in data:
                connection.send(ECHO)
        assert not [answer for answer in [one.recv(4096) for one in data] if b"busy\0" in answer]
        assert order.served.count(ours) == 20  # each was charged to this client
        assert max(order.between(ours)) <= 16
        (mine,) = [client for client in board.clients() if client.name == ours]
        assert mine.requests >= 20


def test_connections_beyond_the_limit_of_the_queue_are_refused_on_the_data_socket(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with serving() as (server, runtime), hostile(runtime, 40) as flood, ExitStack() as opened:
        data = [opened.enter_context(data_socket(runtime)) for _ in range(20)]
        until(lambda: len(server._acceptor._newcomers) == 20)
        with held(server):
            tell(flood, b"sent\n")
            monkeypatch.setattr(server._acceptor, "_places", Places(8, "connections that wait for their turn"))
            for connection in data:
                connection.send(ECHO)
        answers = [connection.recv(4096) for connection in data]
        refused = [answer for answer in answers if b"wait for their turn" in answer]
        assert len(refused) == 14  # a quarter of the places is for others


@contextmanager
def data_socket(runtime: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as made:
        made.settimeout(60)
        made.connect(str(runtime / "data"))
        yield made


def told_of(socket: zmq.Socket[bytes], name: str) -> Any:
    """The manager's present figures of one client."""
    (found,) = [client for client in told_clients(socket) if client.name == name]
    return found


def told_clients(socket: zmq.Socket[bytes]) -> Any:
    socket.send_multipart([b"0", b"", *encode_request(ReadStatus(clients=True))])
    (reply,) = answered(socket, 1)
    return reply.body.clients  # type: ignore[union-attr]


def test_a_client_with_too_much_waiting_is_refused_and_others_are_not(order: Order, context: zmq.Context[Any]) -> None:
    """Each message counts as at least the 1 KiB that it takes to keep it."""
    limits = Limits(waiting_bytes=1 * MIB)
    with (
        serving(limits) as (server, runtime),
        hostile(runtime, CONNECTIONS, EACH) as flood,
        context.socket(zmq.DEALER) as other,
    ):
        other.linger = 0
        other.connect(f"ipc://{runtime}/req")
        asked(other, 1)
        answered(other, 1)
        with held(server):
            tell(flood, b"sent\n")
        for _ in range(100):
            asked(other, 1)
            assert answered(other, 1)[0].error is None
        assert flood.stdout is not None
        assert flood.stdout.readline() == b"answered\n"  # each one, even if with a refusal
        (client,) = [c for c in told_clients(other) if c.connections >= CONNECTIONS]
        assert client.refused > 0
        assert client.requests == CONNECTIONS * (EACH + 1)
        assert client.waiting == 0
        until(lambda: told_of(other, client.name).waiting_bytes == 0)  # libzmq reports later what it has sent


def test_one_connection_may_send_all_it_has_at_once(order: Order, context: zmq.Context[Any]) -> None:
    """Its requests wait in its socket, not in the manager, so none is refused."""
    with serving(Limits(waiting_bytes=1 * MIB)) as (_, runtime), context.socket(zmq.DEALER) as other:
        other.linger = 0
        other.setsockopt(zmq.SNDHWM, 0)
        other.setsockopt(zmq.RCVHWM, 0)
        other.connect(f"ipc://{runtime}/req")
        asked(other, 5000)
        assert all(reply.error is None for reply in answered(other, 5000))


def test_nothing_that_is_published_is_left_behind_beside_requests(context: zmq.Context[Any]) -> None:
    """Its socket signals once that messages came; those not taken then have to be looked for again."""
    with serving() as (server, runtime), hostile(runtime, 20, 200) as flood:
        made = [context.socket(zmq.PUB) for _ in range(3)]
        for socket_ in made:
            socket_.setsockopt(zmq.SNDHWM, 0)
            socket_.connect(f"ipc://{runtime}/sub")
            before = server._dispatcher.taken
            until(lambda: _published(socket_, server) > before, 60)  # noqa: B023 (called at once)
        settled = server._dispatcher.taken
        tell(flood, b"sent\n")
        for _ in range(500):
            for socket_ in made:
                socket_.send_multipart([b"cm_nothing", b""])
        until(lambda: server._dispatcher.taken >= settled + 1500 + 20 * 200, 60)


def _published(socket_: zmq.Socket[bytes], server: daemon.Server) -> int:
    socket_.send_multipart([b"cm_nothing", b""])
    return server._dispatcher.taken
