# SPDX-License-Identifier: Apache-2.0
"""More connections than descriptors: the manager goes on, and serves clients that have few."""

from __future__ import annotations

import os
import resource
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import zmq
from flood import descriptors, half_messages, idle_connections, resident_mib
from keyed_manager import KeyedManager, served_with_keys
from manager_process import until

import cm
from cm.cli.keys import read_key_file
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages.requests import Upload

NOFILE = 1024


def port_of(keyed: KeyedManager) -> int:
    """The first of its three ports."""
    return int(keyed.manager.tcp().rpartition(":")[2])


def allow(keyed: KeyedManager, count: int) -> None:
    """Limit its descriptors."""
    resource.prlimit(keyed.pid, resource.RLIMIT_NOFILE, (count, NOFILE))


@pytest.fixture
def guarded(capsys: pytest.CaptureFixture[str]) -> Iterator[KeyedManager]:
    with served_with_keys() as made:
        allow(made, NOFILE)
        yield made


def works(board: cm.Board) -> bool:
    board.registers["focus"] = 3
    return board.registers["focus"] == 3


@pytest.mark.parametrize("name", ["req", "sub", "pub"])
def test_1500_idle_connections_of_a_user_leave_room_for_a_client(guarded: KeyedManager, name: str) -> None:
    before = descriptors(guarded.pid)
    with idle_connections(guarded.manager.runtime / name, 250, 6) as kept:
        assert sum(kept) <= NOFILE * 3 // 4
        assert descriptors(guarded.pid) <= before + NOFILE * 3 // 4 + 16
        with cm.connect(guarded.manager.tcp(), keys=str(guarded.keys), timeout=60) as board:
            assert works(board)
    until(lambda: descriptors(guarded.pid) <= before + 16)
    with guarded.manager.connected() as board:
        assert works(board)


def test_one_process_has_256_connections_at_most_and_others_go_on_connecting(guarded: KeyedManager) -> None:
    with idle_connections(guarded.manager.runtime / "req", 700, 1) as kept:
        assert kept == [256]
        with guarded.manager.connected() as board:
            assert works(board)


def test_1500_bare_connections_to_a_port_with_keys_leave_room_for_a_client(guarded: KeyedManager) -> None:
    before = descriptors(guarded.pid)
    port = port_of(guarded)
    with idle_connections(("127.0.0.1", port + 2), 250, 6) as kept:
        assert sum(kept) == 256  # of one address
        with guarded.manager.connected() as board:
            assert works(board)
    until(lambda: descriptors(guarded.pid) <= before + 16)
    with cm.connect(guarded.manager.tcp(), keys=str(guarded.keys), timeout=60) as board:
        assert works(board)


def test_the_last_descriptors_are_not_used_for_connections(guarded: KeyedManager) -> None:
    before = descriptors(guarded.pid)
    allow(guarded, before + 200)
    with idle_connections(guarded.manager.runtime / "req", 250, 2) as kept:
        assert 0 < sum(kept) <= 100
    allow(guarded, before + 8)  # none at all: fewer than the reserve
    with idle_connections(guarded.manager.runtime / "req", 50, 2) as kept:
        assert sum(kept) == 0
    allow(guarded, NOFILE)
    with guarded.manager.connected() as board:
        assert works(board)


def frame(flags: int, body: bytes = b"", length: int | None = None) -> bytes:
    return bytes([flags | 2]) + (len(body) if length is None else length).to_bytes(8, "big") + body


def greeting(mechanism: bytes = b"NULL") -> bytes:
    return b"\xff" + bytes(8) + b"\x7f\x03\x00" + mechanism.ljust(20, b"\0") + bytes(32)


def handshake(kind: bytes = b"DEALER") -> bytes:
    """The handshake of ZMTP 3.0 (RFC 23)."""
    ready = b"\x05READY\x0bSocket-Type" + len(kind).to_bytes(4, "big") + kind
    return greeting() + bytes([4, len(ready)]) + ready


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


def test_a_message_of_a_gibibyte_and_a_half_is_refused_when_it_is_announced(guarded: KeyedManager) -> None:
    before = resident_mib(guarded.pid)
    with raw(guarded.manager.runtime / "req") as peer:
        peer.sendall(frame(0, length=3 << 29))
        assert send_until_hung_up(peer, bytes(1 << 20), 1536) < 64
    assert resident_mib(guarded.pid) < before + 64


def test_a_message_of_two_million_parts_ends_its_connection_before_it_is_received(guarded: KeyedManager) -> None:
    before = resident_mib(guarded.pid)
    with raw(guarded.manager.runtime / "req") as peer:
        assert send_until_hung_up(peer, b"\x01\x00" * 1000, 2000) < 2000
    assert resident_mib(guarded.pid) < before + 64
    with guarded.manager.connected() as board:
        assert works(board)


def test_a_message_that_is_too_long_in_all_its_parts_ends_its_connection(guarded: KeyedManager) -> None:
    with raw(guarded.manager.runtime / "req") as peer:
        assert send_until_hung_up(peer, frame(1, bytes(1 << 20)), 64) < 64


def test_a_peer_that_does_not_speak_zmtp_3_is_disconnected(guarded: KeyedManager) -> None:
    for greeting in (b"GET / HTTP/1.1\r\n\r\n", b"\x01\x00", b"\xff" + bytes(8) + b"\x7f\x01\x00" + bytes(52)):
        with socket.socket(socket.AF_UNIX) as peer:
            peer.settimeout(60)
            peer.connect(str(guarded.manager.runtime / "req"))
            peer.sendall(greeting)
            while True:
                try:
                    if not peer.recv(4096):
                        break
                except ConnectionResetError:
                    break


def test_half_messages_of_250_connections_take_no_more_than_those_of_two(guarded: KeyedManager) -> None:
    """Seven MiB of a message over each: 1761 MiB more than idle, before."""
    before = resident_mib(guarded.pid)
    with (
        guarded.manager.connected() as board,
        half_messages(guarded.manager.runtime / "req", handshake(), 250),
        half_messages(guarded.manager.runtime / "sub", handshake(b"PUB"), 20),
    ):
        for _ in range(100):
            assert works(board)
        assert resident_mib(guarded.pid) < before + 64
        test_a_message_of_the_maximum_length_arrives(
            guarded
        )  # among connections that wait, those that keep others waiting are closed
        assert works(board)
    assert resident_mib(guarded.pid) < before + 64


@pytest.mark.parametrize("flags", [0, 4])
def test_before_the_handshake_a_client_may_send_only_short_commands(guarded: KeyedManager, flags: int) -> None:
    """Without a key, before its identity is known."""
    before = resident_mib(guarded.pid)
    long = bytes([flags | 2]) + (1 << 20).to_bytes(8, "big")
    for mechanism, port in ((b"CURVE", 2), (b"CURVE", 0), (b"NULL", 2)):
        with socket.create_connection(("127.0.0.1", port_of(guarded) + port), timeout=60) as peer:
            peer.sendall(greeting(mechanism))
            with suppress(ConnectionError):
                peer.sendall(long)
            assert hangs_up(peer)
    with half_messages(port_of(guarded) + 2, greeting(b"CURVE"), 250), guarded.manager.connected() as board:
        assert works(board)
        assert resident_mib(guarded.pid) < before + 64


def hangs_up(peer: socket.socket) -> bool:
    """Wait until the manager closes the connection, after its part of the handshake."""
    with suppress(ConnectionError):
        while peer.recv(4096):
            pass
    return True


def test_a_million_subscriptions_are_cut_off_after_some_thousand(guarded: KeyedManager) -> None:
    before = resident_mib(guarded.pid)
    with raw(guarded.manager.runtime / "pub", b"SUB") as peer:
        thousand = b"".join(bytes([0, 11]) + b"\x01cm_%07d" % i for i in range(1000))
        assert send_until_hung_up(peer, thousand, 1000) < 1000
    assert resident_mib(guarded.pid) < before + 64


def test_reconnecting_does_not_allow_more_subscriptions(guarded: KeyedManager) -> None:
    """Otherwise each time to as many as one connection may, which libzmq removes all at once when it ends."""
    some = b"".join(bytes([0, 11]) + b"\x01cm_%07d" % i for i in range(900))
    for _ in range(100):
        with raw(guarded.manager.runtime / "pub", b"SUB") as peer, suppress(ConnectionError):
            peer.sendall(some)
            peer.recv(64)
    hung_up(guarded, b"more than 1024 topics at once")
    with cm.connect(guarded.manager.tcp(), keys=str(guarded.keys), timeout=60) as board:
        assert next(iter(board.watch(timeout=60))).mode == "default"  # another client, which may


def test_a_message_of_the_maximum_length_arrives(guarded: KeyedManager) -> None:
    with zmq.Context() as context, context.socket(zmq.REQ) as client:
        client.linger = 0
        client.connect(f"ipc://{guarded.manager.runtime}/req")
        client.send_multipart([b"cm_write_data", b"", bytes((8 << 20) - 64)])
        assert client.poll(60_000)
        assert client.recv_multipart()[0] == b"cm_write_data"


# ---- the same with a key: what it sends is encrypted, and cannot be checked as early -------------


@contextmanager
def with_keys(guarded: KeyedManager) -> Iterator[zmq.Socket[bytes]]:
    """A DEALER that was admitted, and notices when it is disconnected."""
    keys, request = read_key_file(guarded.keys), guarded.manager.tcp("req")
    with zmq.Context() as context, context.socket(zmq.DEALER) as made:
        made.linger = 0
        made.curve_serverkey, made.curve_publickey = keys["server-public"], keys["public"]
        made.curve_secretkey = keys["secret"]
        made.setsockopt(zmq.SNDHWM, 0)
        monitor = made.get_monitor_socket(zmq.EVENT_DISCONNECTED)
        made.connect(request)
        made.send_multipart([b"", b"cm_status", b""])
        assert made.poll(60_000)
        made.recv_multipart()
        yield made
        made.disable_monitor()
        monitor.close(0)


def hung_up(guarded: KeyedManager, cause: bytes) -> None:
    """Check that the manager says why it closed a connection, and continues to serve."""
    assert guarded.manager.process is not None
    assert guarded.manager.process.stderr is not None
    os.set_blocking(guarded.manager.process.stderr.fileno(), False)
    said = bytearray()

    def told() -> bool:
        with suppress(BlockingIOError):
            said.extend(os.read(guarded.manager.process.stderr.fileno(), 65536))  # type: ignore[union-attr]
        return cause in said

    until(told, 60)
    with cm.connect(guarded.manager.tcp(), keys=guarded.keys, timeout=60) as board:
        assert works(board)


def test_encrypted_parts_without_end_are_ended_too(guarded: KeyedManager) -> None:
    before = resident_mib(guarded.pid)
    with with_keys(guarded) as peer:
        peer.send(b"", zmq.SNDMORE)
        for _ in range(100_000):
            peer.send(b"x", zmq.SNDMORE)
        peer.send(b"x")
        hung_up(guarded, b"parts")
    assert resident_mib(guarded.pid) < before + 32


def test_an_encrypted_message_that_is_too_long_is_ended(guarded: KeyedManager) -> None:
    before = resident_mib(guarded.pid)
    with with_keys(guarded) as peer:
        peer.send_multipart([b"", b"cm_upload", bytes(9 << 20)])
        hung_up(guarded, b"too long")
    assert resident_mib(guarded.pid) < before + 32


def test_encrypted_messages_within_bounds_arrive_in_any_number(guarded: KeyedManager) -> None:
    """64 MiB in messages of 4: no more than 16 wait at a time."""
    before = resident_mib(guarded.pid)
    with with_keys(guarded) as peer:
        data = bytes(4 << 20)
        for number in range(16):
            part = Upload(f"u{number}", len(data), 0, data)
            peer.send_multipart([b"", *encode_request(part)])
            peer.send_multipart([b"", *encode_request(Upload(f"u{number}", len(data), discard=True))])
        for _ in range(32):
            assert peer.poll(60_000)
            assert decode_reply(peer.recv_multipart()[1:]).error is None
    assert resident_mib(guarded.pid) < before + 64
