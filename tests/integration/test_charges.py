# SPDX-License-Identifier: Apache-2.0
"""Who pays for what the manager does beside requests: subscriptions, and the slots of streams.

Over TCP without keys a client is of another account than over ipc. What a step costs is said here and not measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import Any

import pytest
import zmq
from daemon_thread import Daemon, daemon
from manager_process import until

from cm.server.shares.budget import Budget
from cm.wire.messages import requests as rq

STEP = 10**12  # nanoseconds of a step beside requests
TOPICS = 300


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    clock = count(0, STEP)
    monkeypatch.setattr("cm.server.streams.background.monotonic_ns", lambda: next(clock))
    with daemon(load="camera/default", listen=("tcp://127.0.0.1:0",)) as made:
        until(lambda: made.status.mode == "default" and not made.status.fpga_busy)
        yield made


def budget(served: Daemon, place: str) -> Budget | None:
    """That of the client in this place."""
    return next((one for one in tuple(served.server._connections.budgets) if one.place.startswith(place)), None)


def steps(served: Daemon, place: str) -> int:
    """How many steps beside requests it has paid for."""
    found = budget(served, place)
    return found.busy_ns // STEP if found else 0


@pytest.fixture
def subscriber(served: Daemon, context: zmq.Context[Any]) -> Iterator[Any]:
    with context.socket(zmq.SUB) as made:
        made.connect(served.server._sockets.tcp[0].pub)
        yield made


def test_who_subscribes_and_goes_pays_for_it(served: Daemon, subscriber: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    paid: list[int] = []
    charge = Budget.charge

    def noted(client: Budget, nanoseconds: int) -> None:
        charge(client, nanoseconds)
        if client.place == "127.0.0.1":
            paid.append(nanoseconds)

    monkeypatch.setattr(Budget, "charge", noted)
    publisher = served.server._publisher
    for number in range(TOPICS):
        subscriber.subscribe(b"nothing/%d" % number)
    until(lambda: publisher.has_subscriber(b"nothing/%d" % (TOPICS - 1)))
    until(lambda: len(paid) >= TOPICS // 32)  # so many are taken at once, at most
    found = budget(served, "127.0.0.1")
    assert found is not None
    assert found.requests == 0
    assert sum(paid) > 0
    before = len(paid)
    subscriber.close(0)
    until(lambda: not publisher.has_subscriber(b"nothing/%d" % (TOPICS - 1)))
    until(lambda: len(paid) - before >= TOPICS // 32)


def test_who_subscribes_to_a_stream_pays_for_its_slots(served: Daemon, subscriber: Any) -> None:
    subscriber.subscribe(b"cm_stream/camera")
    assert subscriber.poll(60_000)
    assert steps(served, "127.0.0.1") >= 1
    assert steps(served, "pid") == 0


def test_who_has_a_stream_run_pays_for_its_slots_and_nobody_when_it_runs_again(served: Daemon) -> None:
    served.done(rq.ConfigureStream("camera", slots=64, enable=True, force=True))
    background = served.server._streams._driver._background
    until(lambda: not background._waiting)
    paid = steps(served, "pid")
    assert paid >= 64 // 8
    served.done(rq.ChangeMode("camera", "edge_detection"))
    until(lambda: any(stream.open for stream in served.status.streams) and not background._waiting)
    assert steps(served, "pid") == paid
