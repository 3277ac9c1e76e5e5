# SPDX-License-Identifier: Apache-2.0
"""The manager's ZeroMQ sockets and locks: where they are bound, how they are announced, who is admitted."""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import zmq
from manager_process import until

from cm.errors import InvalidRequest
from cm.server import sockets as sockets_of_manager
from cm.server.rights.model import Security
from cm.server.settings.model import USUAL
from cm.server.sockets import ENDPOINTS_FILE, Authenticator, Sockets
from cm.wire import multipart

WAIT = 20_000  # ms


@pytest.fixture
def context() -> Iterator[zmq.Context[zmq.Socket[bytes]]]:
    with zmq.Context() as made:
        yield made


@pytest.fixture
def sockets(context: zmq.Context[zmq.Socket[bytes]], tmp_path: Path) -> Iterator[Sockets]:
    made = Sockets(context, tmp_path, waiting=7)
    yield made
    made.close()


@pytest.fixture
def everybody(context: zmq.Context[zmq.Socket[bytes]]) -> Iterator[None]:
    """Answer ZeroMQ's authentication requests by admitting everybody."""
    guard, stop = Authenticator(context, lambda *_: "anybody"), threading.Event()

    def answer() -> None:
        while not stop.is_set():
            if guard.socket.poll(20):
                guard.answer()
        guard.close()

    thread = threading.Thread(target=answer)
    thread.start()
    yield
    stop.set()
    thread.join()


def port(address: str) -> int:
    return int(address.rpartition(":")[2])


def test_port_0_binds_three_consecutive_ports(sockets: Sockets) -> None:
    bound = sockets.bind_tcp("tcp://127.0.0.1:0", None)
    first = port(bound.pub)
    assert (port(bound.sub), port(bound.req)) == (first + 1, first + 2)
    assert sockets.tcp == [bound]
    for number in range(first, first + 3):
        socket.create_connection(("127.0.0.1", number), timeout=60).close()


def test_a_given_port_is_bound_with_the_next_two(sockets: Sockets, context, tmp_path: Path) -> None:
    free = port(sockets.bind_tcp("tcp://127.0.0.1:0", None).pub)
    other = Sockets(context, tmp_path / "other", waiting=1)
    try:
        with pytest.raises(InvalidRequest, match=rf"cannot listen on tcp://127\.0\.0\.1:{free}: Address"):
            other.bind_tcp(f"tcp://127.0.0.1:{free}", None)
    finally:
        other.close()


def test_the_sockets_in_the_folder_replace_those_that_a_killed_manager_left(sockets: Sockets, tmp_path: Path) -> None:
    (tmp_path / "pub").touch()
    sockets.bind_ipc()
    assert all((tmp_path / name).is_socket() for name in ("pub", "sub", "req"))


def test_endpoints_are_announced_and_removed_at_the_end(context, tmp_path: Path) -> None:
    made = Sockets(context, tmp_path, waiting=1)
    made.bind_ipc()
    tcp = made.bind_tcp("tcp://127.0.0.1:0", None)
    made.announce()
    said = json.loads((tmp_path / ENDPOINTS_FILE).read_text())
    assert said["pid"] == os.getpid()
    assert said["ipc"] == {name: f"ipc://{tmp_path}/{name}" for name in ("pub", "sub", "req")}
    assert said["tcp"] == [{"pub": tcp.pub, "sub": tcp.sub, "req": tcp.req}]
    assert said["data"] == f"{tmp_path}/data"
    made.close()
    assert list(tmp_path.iterdir()) == []


def test_what_waits_is_limited_and_a_peer_that_has_gone_is_noticed(context, tmp_path: Path) -> None:
    made = Sockets(context, tmp_path, waiting=7, limits=replace(USUAL, message_bytes=12345))
    for socket_, options in ((made.pub, (7, 512)), (made.sub, (1000, 12345)), (made.req, (0, 12345))):
        assert tuple(map(socket_.getsockopt, (zmq.SNDHWM, zmq.MAXMSGSIZE))) == options
        common = zmq.LINGER, zmq.RCVHWM, zmq.HANDSHAKE_IVL, zmq.IPV6, zmq.TCP_KEEPALIVE, zmq.ZAP_ENFORCE_DOMAIN
        assert tuple(map(socket_.getsockopt, common)) == (0, 16, 10_000, 1, 1, 1)
    made.close()


def is_free(port_: int) -> bool:
    try:
        socket.create_server(("127.0.0.1", port_)).close()
    except OSError:
        return False
    return True


def test_where_the_next_ports_are_taken_others_are_tried_and_in_the_end_it_is_told(
    sockets: Sockets, context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bind, tried = sockets_of_manager._bind, list[str]()

    def taken(socket_: zmq.Socket[bytes], address: str, until: int) -> None:
        tried.append(address)
        if len(tried) < until and not address.endswith(":0"):
            raise InvalidRequest(address)
        bind(socket_, address)

    monkeypatch.setattr(sockets_of_manager, "_bind", partial(taken, until=4))
    first = port(sockets.bind_tcp("tcp://127.0.0.1:0", None).pub)
    assert [address.rpartition(":")[2] for address in tried[2:]] == ["0", str(first + 1), str(first + 2)]
    free = int(tried[1].rpartition(":")[2]) - 1
    until(lambda: is_free(free))  # what was bound before, which ZeroMQ closes in a thread of its own
    tried.clear()
    monkeypatch.setattr(sockets_of_manager, "_bind", partial(taken, until=1000))
    other = Sockets(context, tmp_path / "other", waiting=1)
    with pytest.raises(
        InvalidRequest, match=r"cannot listen on tcp://127\.0\.0\.1:0: no three ports in a row are free"
    ):
        other.bind_tcp("tcp://127.0.0.1:0", None)
    assert len(tried) == 128
    other.close()


@pytest.mark.usefixtures("everybody")
def test_a_subscriber_that_comes_again_is_noticed_again(sockets: Sockets, context) -> None:
    sockets.bind_ipc()
    with context.socket(zmq.SUB) as one, context.socket(zmq.SUB) as two:
        for each in (one, two):
            each.connect(sockets.ipc.pub)
            each.subscribe(b"cm_status")
            assert sockets.pub.poll(WAIT)
            assert sockets.pub.recv() == b"\x01cm_status"


@pytest.mark.usefixtures("everybody")
def test_only_known_topics_are_accepted_from_publishers(sockets: Sockets, context) -> None:
    sockets.bind_ipc()
    with context.socket(zmq.PUB) as client:
        client.connect(sockets.ipc.sub)
        while not sockets.sub.poll(50):  # until the subscription has reached it
            client.send_multipart([b"other", b"x"])
            client.send_multipart([b"cm_config", b"edge"])
        assert sockets.sub.recv_multipart() == [b"cm_config", b"edge"]


# ---- admission -------------------------------------------------------------------------


def ask(context: zmq.Context[zmq.Socket[bytes]], guard: Authenticator, *frames: bytes) -> list[bytes]:
    """The authentication reply that ZeroMQ gets about a connection."""
    with context.socket(zmq.REQ) as asking:
        asking.linger = 0
        asking.connect("inproc://zeromq.zap.01")
        asking.send_multipart([b"1.0", b"17", *frames])
        assert guard.socket.poll(WAIT)
        guard.answer()
        assert asking.poll(WAIT)
        return asking.recv_multipart()


def test_zeromq_learns_which_keys_may_enter_and_under_which_id(context) -> None:
    known, other = zmq.curve_keypair()[0], zmq.curve_keypair()[0]
    raw = {key: zmq.utils.z85.decode(key) for key in (known, other)}
    asked = []

    def admit(*introduction: str) -> str | None:
        asked.append(introduction)
        return "me" if introduction[3] == known.decode() else None

    guard = Authenticator(context, admit)
    at = (b"curve", b"127.0.0.1", b"")
    assert ask(context, guard, *at, b"CURVE", raw[known]) == [b"1.0", b"17", b"200", b"OK", b"me", b""]
    refused = [b"1.0", b"17", b"400", b"not known here", b"", b""]
    assert ask(context, guard, *at, b"CURVE", raw[other]) == refused
    assert ask(context, guard, *at, b"CURVE", b"short") == refused
    assert ask(context, guard, b"ipc", b"localhost:1:2:3", b"", b"NULL") == refused
    assert ask(context, guard, b"ipc") == refused
    assert asked[0] == ("curve", "127.0.0.1", "CURVE", known.decode())
    assert asked[-1] == ("ipc", "localhost:1:2:3", "NULL", "")
    guard.answer()  # without a request nothing happens
    guard.close()


def test_messages_over_tcp_carry_the_identity_that_was_let_in(sockets: Sockets, context) -> None:
    (public, secret), (mine, my_secret) = zmq.curve_keypair(), zmq.curve_keypair()
    guard = Authenticator(context, lambda *introduction: f"somebody with {introduction[3]}")
    bound = sockets.bind_tcp("tcp://127.0.0.1:0", Security(public, secret))
    with context.socket(zmq.DEALER) as client:
        client.linger = 0
        client.curve_serverkey, client.curve_publickey, client.curve_secretkey = public, mine, my_secret
        client.connect(bound.req)
        client.send(b"hello")
        assert guard.socket.poll(WAIT)
        guard.answer()
        assert sockets.req.poll(WAIT)
        message = multipart.receive_from(sockets.req, routed=True)
        assert (message.connection, message.frames[1:]) == (f"somebody with {mine.decode()}", [b"hello"])
    guard.close()
