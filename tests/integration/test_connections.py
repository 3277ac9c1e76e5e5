# SPDX-License-Identifier: Apache-2.0
"""Peers that send too much, or nothing: others are served on. What is not held is in docs/limits.md."""

from __future__ import annotations

import asyncio
import resource
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
import zmq
from flood import descriptors, idle_connections, resident_mib
from keyed_manager import KeyedManager, served_with_keys
from manager_process import Manager, until
from manager_process import served as served_board

import cm
import cm.aio
from cm.server.rights.keys import read_key_file
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages.requests import Upload


@pytest.fixture(scope="module")
def served() -> Iterator[KeyedManager]:
    with served_with_keys() as made:
        yield made


def works(board: cm.Board) -> bool:
    board.registers["focus"] = 3
    return board.registers["focus"] == 3


def port_of(keyed: KeyedManager) -> int:
    """The first of its three ports."""
    return int(keyed.manager.tcp().rpartition(":")[2])


def idle_connections_are_closed(name: str) -> None:
    """As many as leave room for a client, to one socket of a manager of its own, by processes that say nothing."""
    with served_with_keys() as keyed:
        before = descriptors(keyed.pid)
        where = ("127.0.0.1", port_of(keyed) + 2) if name == "port" else keyed.manager.runtime / name
        with idle_connections(where, 250, 6) as kept:
            assert sum(kept) == 1500
            with cm.connect(keyed.manager.tcp(), keys=str(keyed.keys), timeout=60) as board:
                assert works(board)
            until(lambda: descriptors(keyed.pid) <= before + 16)
        with keyed.manager.connected() as board:
            assert works(board)


def test_1500_idle_connections_leave_room_for_a_client_and_are_closed_if_they_say_nothing() -> None:
    """Each socket, at one time: most of it is waiting for the ten seconds that a silent one has."""
    with ThreadPoolExecutor() as threads:
        ends = {name: threads.submit(idle_connections_are_closed, name) for name in ("req", "sub", "pub", "port")}
    assert {name: end.exception() for name, end in ends.items()} == dict.fromkeys(ends)


def test_a_process_that_takes_up_the_descriptors_loses_its_connections(served: KeyedManager) -> None:
    was = resource.prlimit(served.pid, resource.RLIMIT_NOFILE)
    resource.prlimit(served.pid, resource.RLIMIT_NOFILE, (1024, was[1]))
    before = descriptors(served.pid)
    with idle_connections(served.manager.runtime / "req", 700, 1):
        until(lambda: descriptors(served.pid) < before + 200, 9)  # before silent ones are closed anyway
        with served.manager.connected() as board:
            assert works(board)
    resource.prlimit(served.pid, resource.RLIMIT_NOFILE, was)


def frame(flags: int, body: bytes = b"", length: int | None = None) -> bytes:
    return bytes([flags | 2]) + (len(body) if length is None else length).to_bytes(8, "big") + body


def handshake(kind: bytes = b"DEALER") -> bytes:
    """The handshake of ZMTP 3.0 (RFC 23)."""
    ready = b"\x05READY\x0bSocket-Type" + len(kind).to_bytes(4, "big") + kind
    return b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(16 + 32) + bytes([4, len(ready)]) + ready


def raw(path: Path, kind: bytes = b"DEALER") -> socket.socket:
    """A peer after the handshake, without libzmq."""
    made = socket.socket(socket.AF_UNIX)
    made.settimeout(60)
    made.connect(str(path))
    made.sendall(handshake(kind))
    return made


def send_until_hung_up(peer: socket.socket, piece: bytes, times: int) -> int:
    """How many pieces were sent before the manager closed the connection."""
    for sent in range(times):
        try:
            peer.sendall(piece)
        except (BrokenPipeError, ConnectionResetError):
            return sent
    return times


def test_a_frame_of_a_gibibyte_and_a_half_is_refused_when_it_is_announced(served: KeyedManager) -> None:
    before = resident_mib(served.pid)
    with raw(served.manager.runtime / "req") as peer:
        peer.sendall(frame(0, length=3 << 29))
        assert send_until_hung_up(peer, bytes(1 << 20), 1536) < 64
    assert resident_mib(served.pid) < before + 64


def test_who_subscribes_to_thousands_of_topics_is_disconnected(served: KeyedManager) -> None:
    before = resident_mib(served.pid)
    with raw(served.manager.runtime / "pub", b"SUB") as peer, served.manager.connected() as board:
        thousand = b"".join(bytes([0, 11]) + b"\x01cm_%07d" % i for i in range(1000))
        assert send_until_hung_up(peer, thousand, 1000) < 1000
        assert works(board)
    assert resident_mib(served.pid) < before + 64


def test_subscribers_that_come_and_go_do_not_keep_others_from_subscribing(served: KeyedManager) -> None:
    some = b"".join(bytes([0, 11]) + b"\x01cm_%07d" % i for i in range(900))
    for _ in range(100):
        with raw(served.manager.runtime / "pub", b"SUB") as peer:
            peer.sendall(some)
    with cm.connect(served.manager.tcp(), keys=str(served.keys), timeout=60) as board:
        assert next(iter(board.watch(timeout=60))).mode == "default"


def test_a_message_of_the_maximum_length_arrives(served: KeyedManager) -> None:
    with zmq.Context() as context, context.socket(zmq.REQ) as client:
        client.linger = 0
        client.connect(f"ipc://{served.manager.runtime}/req")
        client.send_multipart([b"cm_write_data", b"", bytes((8 << 20) - 64)])
        assert client.poll(60_000)
        assert client.recv_multipart()[0] == b"cm_write_data"


@contextmanager
def with_keys(served: KeyedManager) -> Iterator[zmq.Socket[bytes]]:
    """A DEALER that was admitted."""
    keys, request = read_key_file(served.keys), served.manager.tcp("req")
    with zmq.Context() as context, context.socket(zmq.DEALER) as made:
        made.linger = 0
        made.curve_serverkey, made.curve_publickey = keys["server-public"], keys["public"]
        made.curve_secretkey = keys["secret"]
        made.setsockopt(zmq.SNDHWM, 0)
        made.connect(request)
        yield made


def test_encrypted_messages_within_bounds_arrive_in_any_number(served: KeyedManager) -> None:
    """64 MiB in messages of 4."""
    before = resident_mib(served.pid)
    with with_keys(served) as peer:
        data = bytes(4 << 20)
        for number in range(16):
            part = Upload(f"u{number}", len(data), offset=0, data=data)
            peer.send_multipart([b"", *encode_request(part)])
            peer.send_multipart([b"", *encode_request(Upload(f"u{number}", len(data), discard=True))])
        for _ in range(32):
            assert peer.poll(60_000)
            assert decode_reply(peer.recv_multipart()[1:]).error is None
    assert resident_mib(served.pid) < before + 64


def test_the_end_of_a_manager_is_noticed_though_nothing_is_asked_of_it() -> None:
    """As the page of `cm web` does, which says "connected" until then."""

    async def look(manager: Manager) -> str:
        async with cm.aio.connect(runtime_dir=manager.runtime, timeout=None) as board:
            await board.status()
            gone = asyncio.create_task(board._gone())
            await asyncio.sleep(0)  # so that it waits
            manager.kill()
            try:
                await gone
            except cm.CmError as error:
                return error.code
        return ""

    with served_board() as (manager, _):
        assert asyncio.run(look(manager)) == "connection_lost"
