# SPDX-License-Identifier: Apache-2.0
"""The sockets of a board: how they are set, and that several threads use and close them."""

from __future__ import annotations

import re
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from manager_process import short_folder
from zmq.utils.monitor import recv_monitor_message

from cm.client.connections import Living, Sockets
from cm.client.core.connection_monitor import Handshake
from cm.client.find_manager import Keys
from cm.errors import InvalidRequest
from cm.wire.topics import Endpoints, ipc_endpoints, tcp_endpoints


@pytest.mark.parametrize(("name", "says"), [("b\udcf6ard", r"b\\udcf6ard' .* no UTF-8"), ("x" * 110, "too long")])
def test_a_folder_in_which_no_socket_can_be_is_refused_in_words(name: str, says: str) -> None:
    with pytest.raises(InvalidRequest, match=says):
        ipc_endpoints(Path(name))


def test_a_signal_handler_may_close_what_its_thread_is_closing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that ends the context has been made and not started yet."""
    endpoints: Any = SimpleNamespace(req="inproc://req", pub="inproc://pub")
    sockets = Sockets(zmq.Context(), endpoints, None)
    turn, taken, let = sockets.turn(), threading.Event(), threading.Event()

    def use() -> None:
        with turn:
            taken.set()
            let.wait(60)

    user = threading.Thread(target=use, name="user")
    user.start()
    assert taken.wait(60)
    start = threading.Thread.start

    def late(thread: threading.Thread) -> None:
        if thread.name == "end of a board":
            sockets.close()  # as a signal handler does
            let.set()
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", late)
    sockets.free()
    user.join(60)
    sockets.close()
    assert sockets.closed


def test_of_what_is_no_longer_there_nothing_is_kept() -> None:
    living, things = Living(), [threading.Event() for _ in range(3)]
    for thing in things:
        living.add(thing)
    assert sorted(map(id, living)) == sorted(map(id, things))
    del thing, things
    assert vars(living) == vars(Living())


@pytest.mark.parametrize("keys", [None, Keys(b"s" * 40, b"p" * 40, b"c" * 40)], ids=["plain", "with keys"])
def test_a_socket_is_set_before_it_connects(keys: Keys | None) -> None:
    sockets = Sockets(zmq.Context(), tcp_endpoints("tcp://127.0.0.1:1"), keys)
    try:
        made = [sockets.subscriber((b"",), 3)[0], sockets.subscriber((b"",))[0]]
        assert [socket.getsockopt(zmq.RCVHWM) for socket in made] == [3, 1000]  # the latter is ZeroMQ's own
        made += [sockets.requests()[0], sockets.requests(immediate=True)[0]]
        assert [socket.getsockopt(zmq.IMMEDIATE) for socket in made[2:]] == [0, 1]
        assert [socket.getsockopt(zmq.HEARTBEAT_IVL) for socket in made[2:]] == [2000, 2000]
        assert [socket.getsockopt(zmq.HEARTBEAT_TIMEOUT) for socket in made[2:]] == [6000, 6000]
        for socket in made:
            assert [socket.getsockopt(one) for one in (zmq.LINGER, zmq.IPV6)] == [0, 1]
            assert socket.getsockopt(zmq.MECHANISM) == (zmq.NULL if keys is None else zmq.CURVE)
    finally:
        sockets.close()


def next_try(endpoints: Endpoints) -> int:
    """Milliseconds after which a client tries again to connect to where nobody listens."""
    context = zmq.Context()
    sockets = Sockets(context, endpoints, None)
    try:
        socket, _ = sockets.subscriber((b"",))
        socket.monitor("inproc://tries", zmq.EVENT_CONNECT_RETRIED)
        with context.socket(zmq.PAIR) as monitor:
            monitor.connect("inproc://tries")
            assert monitor.poll(60_000)
            return int(recv_monitor_message(monitor)["value"])
    finally:
        sockets.close()


def test_a_client_tries_to_connect_again_sooner_over_ipc_than_over_tcp() -> None:
    with short_folder() as folder:
        assert 10 <= next_try(ipc_endpoints(folder)) < 20  # ZeroMQ adds some of its own
    assert next_try(tcp_endpoints("tcp://127.0.0.1:1")) >= 100


AUTH, MECHANISM = zmq.EVENT_HANDSHAKE_FAILED_AUTH, zmq.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH
PROTOCOL, NO_DETAIL = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL, zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
ENDED, ADMITTED = zmq.EVENT_DISCONNECTED, zmq.EVENT_HANDSHAKE_SUCCEEDED


@pytest.mark.parametrize(
    ("keys", "event", "value", "words"),
    [
        (True, AUTH, 400, "does not know this key, or it has expired or has no role"),
        (False, AUTH, 400, "gives this user no role"),
        (True, PROTOCOL, MECHANISM, r"has no keys \(--insecure\): connect without keys"),
        (False, PROTOCOL, MECHANISM, r"wants keys: connect\(keys=…\)"),
        (True, PROTOCOL, zmq.PROTOCOL_ERROR_ZMTP_UNSPECIFIED, None),
    ],
)
def test_a_handshake_that_is_refused_says_what_is_missing(
    keys: bool, event: int, value: int, words: str | None
) -> None:
    handshake = Handshake("tcp://kria:5560", keys)
    handshake.take(event, value)
    assert (handshake.refused is None) == (words is None)
    assert re.search(f"the manager at tcp://kria:5560 {words}", str(handshake.refused)) or words is None
    assert not handshake.lost


@pytest.mark.parametrize(
    ("keys", "events", "suspected", "lost"),
    [
        (True, [NO_DETAIL, NO_DETAIL], False, False),
        (True, [NO_DETAIL, NO_DETAIL, NO_DETAIL], True, False),
        (False, [NO_DETAIL, NO_DETAIL, NO_DETAIL], False, False),
        (True, [NO_DETAIL, ENDED, NO_DETAIL, ENDED], False, False),  # it was never established
        (True, [NO_DETAIL, NO_DETAIL, NO_DETAIL, ADMITTED], False, False),
        (True, [NO_DETAIL, NO_DETAIL, ADMITTED, NO_DETAIL], False, False),
        (True, [ADMITTED, ENDED], False, True),
    ],
)
def test_a_manager_with_another_key_is_suspected_after_some_attempts(
    keys: bool, events: list[int], suspected: bool, lost: bool
) -> None:
    handshake = Handshake("tcp://kria:5560", keys)
    for event in events:
        handshake.take(event, 0)
    assert (handshake.suspected is not None, handshake.lost, handshake.refused) == (suspected, lost, None)
    if suspected:
        assert "at tcp://kria:5560 is ended: it has another key than" in str(handshake.suspected)
