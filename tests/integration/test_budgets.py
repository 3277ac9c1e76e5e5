# SPDX-License-Identifier: Apache-2.0
"""How much of the manager's memory one client may use, while another goes on."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
import zmq
from flood import resident_mib, unread_replies
from manager_process import Manager, served, until

import cm
from cm.cli.main import main
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import Reply

pytestmark = pytest.mark.soak

MIB = 1 << 20
DESCRIBED = ", ".join(f"r{i}: {{offset: {0x100 + 4 * i:#x}, doc: {'register ' * 100}}}" for i in range(7))
SCHEMA = f"""
config:
  name: many
  regions: [left]
  modules: {{fir: {{region: left}}}}
  mmio: [{{base_address: 0x1000, registers: {{led: {{offset: 0x10}}, {DESCRIBED}}}}}]
  memories: {{big: {{base_address: 0x10000000, size: 0xA00000}}}}
  modes: {{default: {{modules: [fir]}}}}
"""


@pytest.fixture(scope="module")
def manager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Manager]:
    schema = tmp_path_factory.mktemp("many") / "many.yaml"
    schema.write_text(SCHEMA, encoding="utf-8")
    with served(schemas=schema) as (made, _):
        with made.connected() as board:
            board.load("many", "default")
        yield made


def dealer(context: zmq.Context[Any], manager: Manager) -> Any:
    """A client that reads as little from its connection as possible."""
    made = context.socket(zmq.DEALER)
    made.setsockopt(zmq.RCVHWM, 1)
    made.setsockopt(zmq.RCVBUF, 4096)
    made.connect(f"ipc://{manager.runtime}/req")
    return made


def replies(sockets: list[Any], count: int) -> list[Reply]:
    """That many replies over all connections, in the order of arrival."""
    poller = zmq.Poller()
    for socket in sockets:
        poller.register(socket, zmq.POLLIN)
    found: list[Reply] = []
    while len(found) < count:
        ready = poller.poll(60_000)
        assert ready, f"{len(found)} of {count} replies came"
        found += [decode_reply(socket.recv_multipart()) for socket, _ in ready]
    return found


def works(board: cm.Board) -> bool:
    board.registers["led"] = 3
    return board.registers["led"] == 3


def test_unread_answers_have_a_limit_in_bytes(manager: Manager, context: zmq.Context[Any]) -> None:
    """Ten clients that ask for 200 MiB each: without a limit, gigabytes."""
    ask = encode_request(rq.ReadData("big", length=4 * MIB))
    with manager.connected() as board:
        assert works(board)
        before = resident_mib(manager.pid)
        readers = [dealer(context, manager) for _ in range(10)]
        for reader in readers:
            for _ in range(50):
                reader.send_multipart(ask)
        assert works(board)
        until(lambda: board.clients()[0].requests > 450, 60)
        until(lambda: board.clients()[0].waiting_bytes > 8 * MIB, 60)
        assert works(board)
        assert resident_mib(manager.pid) < before + 64
    found = replies(readers, 500)
    codes = Counter(reply.error.code if reply.error else "" for reply in found)
    assert codes[""] >= 16  # waiting replies were made when there was room
    assert codes.keys() == {"", "too_much_waiting"}
    until(lambda: resident_mib(manager.pid) < before + 32, 60)


def test_short_unread_answers_have_the_same_limit(manager: Manager) -> None:
    """250 connections of a process ask for 375 MiB in answers of 15 KiB: without a limit, 318 MiB more."""
    with manager.connected() as board:
        assert works(board)
        before = resident_mib(manager.pid)
        with unread_replies(manager.runtime, 250, 100) as hostile:
            name = f"pid {hostile.pid} "

            def unread() -> int:
                return sum(client.unread_bytes for client in board.clients() if client.name.startswith(name))

            until(lambda: unread() > 15 * MIB, 60)
            for _ in range(200):
                assert works(board)
            assert unread() <= 2 * (16 * MIB) + 250 * (48 << 10)  # refusals too, and each has 32 KiB in any case
            assert resident_mib(manager.pid) < before + 64
            assert hostile.stdin
            assert hostile.stdout
            hostile.stdin.write("read them\n")
            hostile.stdin.flush()
            read, whole = map(int, hostile.stdout.readline().split())
            assert read == 25_000  # none was lost meanwhile,
            assert 1000 < whole < read  # and the others were refused
            until(lambda: unread() == 0, 60)
        assert resident_mib(manager.pid) < before + 64
        until(lambda: not [client for client in board.clients() if client.name.startswith(name)], 60)


def test_a_client_that_leaves_without_reading_leaves_nothing_behind(manager: Manager) -> None:
    with manager.connected() as board:
        before = resident_mib(manager.pid)
        with unread_replies(manager.runtime, 100, 100) as hostile:
            name = f"pid {hostile.pid} "
            until(lambda: [x for x in board.clients() if x.name.startswith(name) and x.unread_bytes > 15 * MIB], 60)
        until(lambda: not [client for client in board.clients() if client.name.startswith(name)], 60)
        assert works(board)
        assert resident_mib(manager.pid) < before + 64


def test_a_client_that_asks_for_many_answers_before_it_reads_loses_none(
    manager: Manager, context: zmq.Context[Any]
) -> None:
    """By default, ZeroMQ drops more than a thousand on a connection."""
    with manager.connected() as board:
        assert works(board)
    asker = dealer(context, manager)
    asker.setsockopt(zmq.SNDHWM, 0)
    asks = [encode_request(rq.ReadReg(("led",))), encode_request(rq.ReadIrq("none"))]
    for number in range(8000):
        asker.send_multipart([b"%d" % number, b"", *asks[number % 2]])
    for number in range(8000):
        assert asker.poll(60_000), f"{number} of 8000 came"
        mark, _, *reply = asker.recv_multipart()
        assert mark == b"%d" % number
        assert (decode_reply(reply).error is None) == (number % 2 == 0)


def test_a_clients_waiting_requests_have_a_limit_in_bytes(manager: Manager, context: zmq.Context[Any]) -> None:
    write = encode_request(rq.WriteData("big", bytes(4 * MIB)))
    with manager.connected() as board:
        before = resident_mib(manager.pid)
        writer = dealer(context, manager)
        for _ in range(30):
            writer.send_multipart(write)
        assert works(board)
        codes = Counter(r.error.code if r.error else "" for r in replies([writer], 30))
        assert codes[""] >= 4
        assert codes["too_much_waiting"] == 30 - codes[""]
        assert resident_mib(manager.pid) < before + 64


def test_the_command_line_shows_what_each_client_takes(manager: Manager, capsys: pytest.CaptureFixture[str]) -> None:
    with manager.connected() as board, board.lease("registers:led", seconds=60):
        where = ["--runtime-dir", str(manager.runtime)]
        assert main(["status", "--clients", *where]) == 0
        head, *rows = capsys.readouterr().out.splitlines()
        assert head.split()[:4] == ["CLIENT", "ACCOUNT", "CONNECTIONS", "LEASES"]
        (mine,) = [row for row in rows if row.startswith(f"pid {os.getpid()} ")]
        assert f"uid:{os.getuid()}" in mine
        assert main(["status", "--clients", "--json", *where]) == 0
        (told,) = [one for one in json.loads(capsys.readouterr().out) if one["leases"]]
        assert told["name"].startswith(f"pid {os.getpid()} ")
        assert (told["account"], told["leases"]) == (f"uid:{os.getuid()}", 1)


def test_subscribers_that_do_not_read_leave_a_bounded_number_of_frames_waiting(context: zmq.Context[Any]) -> None:
    """Each later one keeps other frames waiting: without a limit, 80 took 670 MiB. One that reads stays connected."""
    with served(settings="streams: {queue_mib: 2}\n") as (manager, _), manager.connected() as board:
        board.load("camera", "default")

        def subscriber(waiting: int) -> tuple[Any, Any]:
            made = context.socket(zmq.SUB)
            made.linger, made.rcvhwm, made.rcvbuf = 0, waiting, 4096
            made.reconnect_ivl = -1  # a closed connection does not reconnect, so that it can be counted
            made.subscribe(b"cm_stream/camera")
            monitor = made.get_monitor_socket(zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_DISCONNECTED)
            made.connect(f"ipc://{manager.runtime}/pub")
            assert monitor.poll(60_000)
            monitor.recv_multipart()  # it is connected
            return made, monitor

        def connections() -> int:
            return sum(client.connections for client in board.clients())

        reader, ended = subscriber(0)
        hostile: list[tuple[Any, Any]] = []
        before = connections()
        while len(hostile) < 20 or connections() > before + 10:  # each keeps two frames; nine may wait in all
            if len(hostile) < 20:
                hostile.append(subscriber(1))
            for _ in range(5):
                assert reader.poll(60_000)
                reader.recv_multipart()
        assert not ended.poll(0)
        for made, monitor in ((reader, ended), *hostile):
            made.disable_monitor()
            monitor.close(0)
            made.close(0)


def test_no_client_gets_anothers_answers_by_its_routing_id(manager: Manager, context: zmq.Context[Any]) -> None:
    """Nor can it keep them from arriving: the first to use an id has it."""
    ask = [b"", *encode_request(rq.ReadReg(("led",)))]
    victim, thief = (context.socket(zmq.DEALER) for _ in range(2))
    for one in (victim, thief):
        one.linger, one.routing_id = 0, b"arm"
    victim.connect(f"ipc://{manager.runtime}/req")
    victim.send_multipart(ask)
    assert victim.poll(60_000)
    victim.recv_multipart()
    monitor = thief.get_monitor_socket(zmq.EVENT_HANDSHAKE_SUCCEEDED)
    thief.connect(f"ipc://{manager.runtime}/req")
    assert monitor.poll(60_000)
    for _ in range(50):
        victim.send_multipart(ask)
        assert victim.poll(60_000)
        assert decode_reply(victim.recv_multipart()[1:]).error is None
    assert not thief.poll(0)
    thief.disable_monitor()
    monitor.close(0)
