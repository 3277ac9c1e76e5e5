# SPDX-License-Identifier: Apache-2.0
"""The manager looks after windows that the kernel takes back, as long as there is something that tells of them."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from cm.server.streams.peer import Peer
from cm.server.windows import OpenWindows
from cm.wire.messages.status import ConfigInfo
from cm.wire.plane_packets import Open

TELLS = 7000  # the descriptor that tells of windows taken back


class Lends:
    """Windows of a manager: lends to all."""

    def __init__(self) -> None:
        self.gone = False
        self.closing: Callable[[], None] = lambda: None

    def lend(self, *_: Any) -> tuple[Any, int]:
        place = SimpleNamespace(module="edge", config=SimpleNamespace(name="camera"), mode="on", address=0, length=4096)
        info = ConfigInfo("camera", "partial", "on")
        loan = SimpleNamespace(place=place, info=info, status=SimpleNamespace(region="prr0"), lease="", number=1)
        return loan, os.memfd_create("pages")

    def fileno(self) -> int:
        return TELLS

    def collect(self) -> None:
        if self.gone:
            raise OSError("no such board")

    def give_back(self, number: int) -> None: ...


class Watched(dict[int, Callable[[], object]]):
    """A loop: what it watches."""

    def add(self, fd: int, on_readable: Callable[[], object]) -> None:
        assert fd not in self
        self[fd] = on_readable

    def remove(self, fd: int) -> None:
        del self[fd]


def opened(windows: OpenWindows) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        windows.open(ours, Open("edge", window=True), Peer.ourselves())


def test_what_tells_of_windows_taken_back_is_watched_while_there_is_a_board() -> None:
    loop, lends = Watched(), Lends()
    windows = OpenWindows(loop, SimpleNamespace(windows=lends), SimpleNamespace(), SimpleNamespace())  # type: ignore[arg-type]
    opened(windows)
    opened(windows)
    loop[TELLS]()
    assert TELLS in loop
    lends.gone = True
    loop[TELLS]()
    assert TELLS not in loop
    lends.gone = False
    opened(windows)  # of the next board
    assert TELLS in loop
    lends.closing()  # the descriptor is about to be another's
    assert TELLS not in loop
    windows.close()
    assert loop == {}
