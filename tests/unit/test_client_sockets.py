# SPDX-License-Identifier: Apache-2.0
"""The sockets of a board that several threads use and close."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest
import zmq

from cm.client.sockets import Sockets


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
