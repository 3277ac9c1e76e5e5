# SPDX-License-Identifier: Apache-2.0
"""What a request costs the manager's loop, in calls of its Python functions; `cm bench` measures time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from daemon_thread import Daemon, Subscriber, daemon

import cm
from cm.server.dispatcher import Dispatcher
from cm.wire.messages import requests as rq

OURS = str(Path(cm.__file__).parent)  # how many functions a library calls is its own, and each version's
ARRIVED: CodeType = Dispatcher.on_request.__code__


class Calls:
    """The functions called for each message from its arrival on."""

    def __init__(self) -> None:
        self.messages: list[list[str]] = []
        self._thread = 0
        self._inside: FrameType | None = None
        self._called: list[str] = []

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code is ARRIVED:
            self._thread, self._inside, self._called = threading.get_ident(), frame, []
        elif self._inside is None or threading.get_ident() != self._thread:
            return
        elif event == "call" and frame.f_code.co_filename.startswith(OURS):
            self._called.append(frame.f_code.co_name)
        elif event == "return" and frame is self._inside:
            self.messages.append(self._called)
            self._inside = None


@pytest.fixture(scope="module")
def calls() -> Iterator[Calls]:
    counted = Calls()
    threading.setprofile(counted)
    yield counted
    threading.setprofile(None)


@pytest.fixture(scope="module")
def camera(calls: Calls) -> Iterator[Daemon]:
    with daemon(load="camera/default") as made:
        made.load("default")
        yield made


def usual(camera: Daemon, calls: Calls, request: Any) -> list[str]:
    """The calls of a request that was made before."""
    camera.done(request)
    camera.done(request)
    calls.messages.clear()
    for _ in range(5):
        camera.done(request)
    camera.status  # noqa: B018 (behind it, the five have ended)
    return min(calls.messages[:5], key=len)


@pytest.mark.parametrize(
    ("request_", "most"),
    [(rq.ReadReg(("focus",)), 19), (rq.WriteReg((rq.RegWrite("focus", 2),)), 43)],
    ids=["read of a register", "write of a register"],
)
def test_a_request_for_a_register_calls_few_functions(camera: Daemon, calls: Calls, request_: Any, most: int) -> None:
    called = usual(camera, calls, request_)
    assert 9 < len(called) <= most, called


def test_registers_are_encoded_again_only_when_there_is_a_listener(camera: Daemon, calls: Calls) -> None:
    write = rq.WriteReg((rq.RegWrite("focus", 2),))
    alone = usual(camera, calls, write)
    listener = Subscriber(camera, b"cm_read_reg")
    told = usual(camera, calls, write)
    listener.close()
    assert (alone.count("registers_into"), told.count("registers_into")) == (1, 2)
