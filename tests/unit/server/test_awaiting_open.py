# SPDX-License-Identifier: Apache-2.0
"""Connections to the data socket before they say what they want: how many come in, and who makes room."""

from __future__ import annotations

import socket
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.server.streams import data_socket
from cm.server.streams.data_socket import WAITING, DataSocket

LISTENER = 7000  # its descriptor


class Bench:
    """A listener whose connections come when a test says so; a loop of which it takes the turns."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 10.0
        monkeypatch.setattr(data_socket, "time", SimpleNamespace(monotonic=self._time))
        self.takes = 0.0  # seconds for each connection
        self.coming: list[str | Exception] = []
        self.watched: dict[int, Callable[[], object]] = {}
        self.paused: set[int] = set()
        self.later: list[tuple[float, Callable[[], object]]] = []
        self.cancelled = 0
        self.heard: list[tuple[str, bytes]] = []
        self.whose: dict[socket.socket, str] = {}
        self.clients: list[socket.socket] = []
        loop: Any = SimpleNamespace(
            add=self.watched.__setitem__, remove=self.watched.pop, pause=self.paused.add, resume=self.paused.remove,
            call_later=self._call_later,
        )  # fmt: skip
        listener: Any = SimpleNamespace(accept=self._accept, fileno=lambda: LISTENER, close=lambda: None)
        rights: Any = SimpleNamespace(whose=self._whose)
        self.socket = DataSocket(loop, folder, {}, rights, SimpleNamespace(run=list))  # type: ignore[arg-type]
        self.socket.open()
        self.watched[LISTENER] = self.watched.popitem()[1]
        self.socket._listener.close()
        monkeypatch.setattr(self.socket, "_listener", listener)
        monkeypatch.setattr(self.socket, "_serve", self._serve)

    def _time(self) -> float:
        return self.now

    def _call_later(self, seconds: float, call: Callable[[], object]) -> Any:
        self.later.append((seconds, call))
        return SimpleNamespace(cancel=self._cancel)

    def _cancel(self) -> None:
        self.cancelled += 1

    def _accept(self) -> tuple[socket.socket, None]:
        if not self.coming:
            raise BlockingIOError
        self.now += self.takes
        who = self.coming.pop(0)
        if isinstance(who, Exception):
            raise who
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        theirs.setblocking(False)
        self.clients.append(theirs)
        self.whose[ours] = who
        return ours, None

    def _whose(self, connection: socket.socket) -> str:
        if self.whose[connection] == "gone":
            raise OSError
        return self.whose[connection]

    def _serve(self, connection: socket.socket, packet: bytes) -> Generator[None, None, None]:
        self.heard.append((self.whose[connection], packet))
        connection.close()
        yield

    @property
    def waiting(self) -> int:
        return len(self.socket._waiting)

    def come(self, *who: str | Exception) -> list[socket.socket]:
        """The other ends of these connections."""
        before = len(self.clients)
        self.coming += who
        while self.coming:
            self.watched[LISTENER]()
        return self.clients[before:]

    def close(self) -> None:
        if self.watched:
            self.socket.close()
        for client in self.clients:
            client.close()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    made = Bench(tmp_path, monkeypatch)
    yield made
    made.close()


def ended(client: socket.socket) -> bool:
    try:
        return client.recv(1) == b""
    except BlockingIOError:
        return False


def test_so_many_come_in_at_once_and_the_next_after_three_times_as_long(bench: Bench) -> None:
    bench.takes = 0.001
    bench.coming += ["a"] * 20
    bench.watched[LISTENER]()
    ((seconds, rested),) = bench.later
    assert (bench.waiting, seconds, bench.paused) == (16, pytest.approx(0.048), {LISTENER})
    rested()
    bench.watched[LISTENER]()
    assert (bench.waiting, len(bench.later), bench.paused) == (20, 1, set())
    bench.takes = 0.0
    bench.coming += [OSError(24, "no descriptors"), "b"]
    bench.watched[LISTENER]()
    assert (bench.coming, bench.later[1][0]) == (["b"], 0.002)  # it waits in the backlog
    bench.socket.close()
    assert (bench.cancelled, bench.watched, bench.waiting) == (1, {}, 0)
    assert all(map(ended, bench.clients))


def test_what_has_gone_before_it_came_in_is_forgotten(bench: Bench) -> None:
    gone, there = bench.come("gone", ConnectionAbortedError(), "a")
    assert (ended(gone), ended(there), bench.waiting) == (True, False, 1)


def test_who_speaks_is_heard_once_and_who_hangs_up_is_not(bench: Bench) -> None:
    speaks, silent, hangs_up = bench.come("a", "b", "c")
    speaks.send(b"open")
    speaks.send(b"more")
    hangs_up.close()
    for fd in [fd for fd in bench.watched if fd != LISTENER]:
        bench.watched[fd]()
    assert bench.heard == [("a", b"open")]
    assert (bench.waiting, ended(silent), set(bench.watched)) == (0, True, {LISTENER})


def test_the_process_with_most_makes_room_and_none_has_more_than_three_quarters(bench: Bench) -> None:
    most = WAITING * 3 // 4
    many = bench.come(*["many"] * (most + 1))
    assert [number for number, one in enumerate(many) if ended(one)] == [0]
    few = bench.come(*["few"] * (WAITING - most))
    assert not any(map(ended, [*many[1:], *few]))
    bench.come("new")
    assert [number for number, one in enumerate(many[1:]) if ended(one)] == [0]
    assert (bench.waiting, any(map(ended, few))) == (WAITING, False)
