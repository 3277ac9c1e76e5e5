# SPDX-License-Identifier: Apache-2.0
"""The manager looks after windows that the kernel takes back, as long as there is something that tells of them."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from cm.errors import Busy, Forbidden
from cm.manager.access.register_windows import WindowRequest
from cm.manager.errors import HeldBy, ModuleAbsent
from cm.server.client_process import Peer
from cm.server.window_clients import EACH, MOST, OpenWindows
from cm.wire import plane_packets as packets
from cm.wire.messages.status import ConfigInfo
from cm.wire.plane_packets import Open, Purpose

TELLS = 7000  # the descriptor that tells of windows taken back


class Lends:
    """Windows of a manager: lends to all, unless there is a reason not to."""

    def __init__(self) -> None:
        self.gone = False
        self.refuses: Exception | None = None
        self.asked: list[WindowRequest] = []
        self.ended: list[Callable[[int, str, str], None]] = []
        self.given_back: list[int] = []
        self.closing: Callable[[], None] = lambda: None

    def lend(self, request: WindowRequest, _: Any, ended: Any) -> tuple[Any, int]:
        self.asked.append(request)
        if self.refuses is not None:
            raise self.refuses
        self.ended.append(ended)
        place = SimpleNamespace(module="edge", config=SimpleNamespace(name="camera"), mode="on", address=0, length=4096)
        info = ConfigInfo("camera", "partial", "on")
        number = len(self.ended)
        loan = SimpleNamespace(place=place, info=info, status=SimpleNamespace(region="prr0"), lease="l", number=number)
        return loan, os.memfd_create("pages")

    def fileno(self) -> int:
        return TELLS

    def collect(self) -> None:
        if self.gone:
            raise OSError("no such board")

    def give_back(self, number: int) -> str | None:
        self.given_back.append(number)
        return f"written through {number}" if number == 1 else None


class Watched(dict[int, Callable[[], object]]):
    """A loop: what it watches."""

    def add(self, fd: int, on_readable: Callable[[], object]) -> None:
        assert fd not in self
        self[fd] = on_readable

    def remove(self, fd: int) -> None:
        del self[fd]

    def call_threadsafe(self, call: Callable[[], None]) -> None:
        call()


class Bench:
    """Windows, their clients' ends of the connections, and what was told."""

    def __init__(self) -> None:
        self.loop, self.lends, self.told = Watched(), Lends(), list[object]()
        self.forbidden: Exception | None = None
        manager: Any = SimpleNamespace(windows=self.lends, tell_registers=self.told.append)
        rights: Any = SimpleNamespace(check_open=self._check, whose=lambda _: "ipc")
        self.windows = OpenWindows(self.loop, manager, SimpleNamespace(), rights)  # type: ignore[arg-type]
        self.clients: list[socket.socket] = []

    def _check(self, *_: Any) -> None:
        if self.forbidden is not None:
            raise self.forbidden

    def open(self, pid: int = 7, purpose: Purpose = Purpose.WINDOW, **wanted: Any) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.clients.append(theirs)
        theirs.setblocking(False)
        with ours:
            self.windows.open(ours, Open("edge", purpose, **wanted), Peer(pid, "user", pid))
        return theirs

    def close(self) -> None:
        self.windows.close()
        for client in self.clients:
            client.close()


@pytest.fixture
def bench() -> Any:
    made = Bench()
    yield made
    made.close()


def said(client: socket.socket) -> bytes:
    data, fds, _, _ = socket.recv_fds(client, packets.PACKET_MAX, packets.FDS_MAX)
    for fd in fds:
        os.close(fd)
    return data


def test_a_client_gets_the_pages_of_what_it_asks_for_until_they_are_taken_back(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "cm")
    user = bench.open(purpose=Purpose.WRITABLE_WINDOW, exclusive=True, lease="mine")
    assert bench.lends.asked == [WindowRequest("edge", True, True, "mine", "pid 7 (user)", 7)]
    assert caplog.messages == ["registers of edge mapped by pid 7 (user)"]
    pages = packets.decode_window(said(user))
    assert (pages.address, pages.length, pages.writable) == (0, 4096, True)
    assert (pages.region, pages.module, pages.config_name, pages.mode, pages.lease) == (
        "prr0",
        "edge",
        "camera",
        "on",
        "l",
    )
    bench.lends.ended[0](1, "other", "off")
    assert packets.decode_revoked(said(user)) == (1, "other", "off")
    assert said(user) == b""
    bench.lends.ended[0](1, "other", "off")  # it is no longer there
    assert (bench.lends.given_back, bench.told) == ([1], ["written through 1"])
    quiet = bench.open()
    next(call for fd, call in bench.loop.items() if fd != TELLS)()  # whoever says anything, or hangs up
    assert (bench.lends.given_back, bench.told, said(quiet)[:0]) == ([1, 2], ["written through 1"], b"")
    assert set(bench.loop) == {TELLS}


def test_a_client_that_would_wait_gets_its_window_after_a_change(bench: Bench) -> None:
    bench.lends.refuses = ModuleAbsent("edge is not loaded")
    with pytest.raises(ModuleAbsent):
        bench.open()
    waits, other = bench.open(wait=True), bench.open(wait=True)
    for refuses in (HeldBy("somebody has it"), None):
        bench.lends.refuses = refuses
        bench.windows.ask_again()
    assert [packets.decode_window(said(one)).module for one in (waits, other)] == ["edge", "edge"]
    bench.windows.ask_again()
    assert len(bench.lends.asked) == 7


@pytest.mark.parametrize(
    ("error", "code"), [(Forbidden("no right"), "forbidden"), (OSError(5, "it broke"), "device_error")]
)
def test_a_client_that_waits_in_vain_is_told_why(bench: Bench, error: Exception, code: str) -> None:
    bench.lends.refuses = ModuleAbsent("edge is not loaded")
    waits = bench.open(wait=True)
    bench.forbidden = error
    bench.windows.ask_again()
    assert packets.decode_refused(said(waits)) == (code, str(error))
    assert (said(waits), bench.loop, bench.lends.given_back) == (b"", {}, [])


def test_a_user_has_so_many_windows_and_all_have(bench: Bench) -> None:
    for pid, number in ((1, EACH), (2, MOST - EACH)):
        for _ in range(number):
            bench.open(pid)
    for pid in (1, 2):
        with pytest.raises(Busy, match=f"a user has at most {EACH} windows, all together {MOST}; give one back"):
            bench.open(pid)
    with pytest.raises(Busy):
        bench.open(99)
    next(call for fd, call in bench.loop.items() if fd != TELLS)()
    bench.open(99)
    bench.lends.refuses = OSError(5, "it broke")
    bench.windows.close()
    with pytest.raises(OSError, match="it broke"):
        bench.open()
    assert bench.loop == {}


def test_what_tells_of_windows_taken_back_is_watched_while_there_is_a_board(bench: Bench) -> None:
    loop, lends = bench.loop, bench.lends
    bench.open()
    bench.open()
    loop[TELLS]()
    assert TELLS in loop
    lends.gone = True
    loop[TELLS]()
    assert TELLS not in loop
    lends.gone = False
    bench.open()  # of the next board
    assert TELLS in loop
    lends.closing()  # the descriptor is about to be another's
    assert TELLS not in loop
    bench.windows.close()
    assert loop == {}
