# SPDX-License-Identifier: Apache-2.0
"""Which connection is ended where frames wait for subscribers that do not read (`Connections.end_stuck`)."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from cm.server.connections import Connections

PIECE = bytes(1000)


class Subscriber:
    """A connection to the manager's socket for publications, with both of its ends here."""

    def __init__(self, listener: socket.socket) -> None:
        self._theirs = socket.socket(socket.AF_UNIX)
        self._theirs.connect(listener.getsockname())
        self._ours = listener.accept()[0]
        self._theirs.setblocking(False)
        for _ in range(5):
            self._ours.send(PIECE)

    def takes(self) -> bytes:
        return self._theirs.recv(len(PIECE))

    @property
    def ended(self) -> bool:
        """Whether what came is followed by an end."""
        try:
            while self._theirs.recv(1 << 16):
                pass
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        self._ours.close()
        self._theirs.close()


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Subscriber, Subscriber]]:
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "pub"))
        listener.listen()
        made = Subscriber(listener), Subscriber(listener)
        yield made
        for one in made:
            one.close()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("cm.server.connections.time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_of_two_subscribers_the_one_that_takes_nothing_is_ended(
    tmp_path: Path, two: tuple[Subscriber, Subscriber], clock: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    slow, stuck = two
    connections = Connections(tmp_path, [])
    for _ in range(3):
        connections.end_stuck()
        assert slow.takes() == PIECE
        clock[0] += 0.06
    assert [slow.ended, stuck.ended] == [False, True]
    assert caplog.text.count("it left frames unread for longest") == 1


def test_nobody_is_ended_for_what_was_unread_a_moment_ago(
    tmp_path: Path, two: tuple[Subscriber, Subscriber], clock: list[float]
) -> None:
    connections = Connections(tmp_path, [])
    for _ in range(100):  # asked again and again
        connections.end_stuck()
    clock[0] += 0.06
    connections.end_stuck()
    assert [one.ended for one in two] == [False, False]  # and have read all
    clock[0] += 10.0
    connections.end_stuck()
    assert [one.ended for one in two] == [False, False]
