# SPDX-License-Identifier: Apache-2.0
"""The sockets of a board that several threads use and close."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from manager_process import short_folder
from zmq.utils.monitor import recv_monitor_message

from cm.client.connections import Sockets
from cm.wire.topics import Endpoints, ipc_endpoints, tcp_endpoints


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
