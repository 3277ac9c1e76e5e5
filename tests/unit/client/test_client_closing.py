# SPDX-License-Identifier: Apache-2.0
"""A board that is closed while its data socket is being opened: a manager that accepts, and never answers."""

from __future__ import annotations

import asyncio
import queue
import socket
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_process import short_folder

from cm.client import aio
from cm.client.board import Board
from cm.client.connections import Living
from cm.client.data_connection import DataConnection
from cm.client.errors import BoardClosed
from cm.wire import plane_packets as packets

HUNG = 60.0
OPENED: dict[str, Callable[[Board], Any]] = {
    "stream": lambda board: board.stream("camera", timeout=None).open(),
    "read": lambda board: board.stream("camera", timeout=None).read(),
    "writer": lambda board: board.writer("camera", timeout=None),
    "memory": lambda board: board.allocate(64, timeout=None),
}
OPENED_ASYNC: dict[str, Callable[[aio.Board], Awaitable[Any]]] = {
    "stream": lambda board: board.stream("camera", timeout=None).open(),
    "read": lambda board: board.stream("camera", timeout=None).read(),
    "writer": lambda board: board.writer("camera", timeout=None).__aenter__(),
    "memory": lambda board: board.allocate(64, timeout=None),
}


class Silent:
    """The data socket of a manager that says nothing."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "req").touch()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.settimeout(HUNG)
        self._listener.bind(str(folder / packets.SOCKET))
        self._listener.listen()
        self._peers: list[socket.socket] = []

    def asked(self) -> socket.socket:
        """The connection of the next client, which has asked for something."""
        peer, _ = self._listener.accept()
        peer.settimeout(HUNG)
        self._peers.append(peer)
        assert peer.recv(packets.PACKET_MAX)
        return peer

    def close(self) -> None:
        for peer in (*self._peers, self._listener):
            peer.close()


@pytest.fixture
def silent() -> Iterator[Silent]:
    with short_folder() as folder:
        made = Silent(folder)
        yield made
        made.close()


def _begun(call: Callable[[], Any]) -> Callable[[], Any]:
    """Call in a thread of its own; what comes of it."""
    ends: queue.Queue[BaseException | None] = queue.Queue()

    def run() -> None:
        try:
            call()
        except BaseException as error:  # noqa: BLE001 (which it is, is what the tests are about)
            ends.put(error)
        else:
            ends.put(None)

    threading.Thread(target=run, daemon=True).start()
    return lambda: ends.get(timeout=HUNG)


@pytest.mark.parametrize("what", OPENED)
def test_closing_a_board_frees_the_thread_that_waits_for_the_managers_answer(silent: Silent, what: str) -> None:
    board = Board(runtime_dir=silent.folder)
    ended = _begun(lambda: OPENED[what](board))
    silent.asked()
    board.close()
    assert type(ended()) is BoardClosed


@pytest.mark.parametrize("what", OPENED)
def test_a_board_that_is_closed_before_it_knows_the_connection_frees_it_too(
    silent: Silent, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = Board(runtime_dir=silent.folder)
    connect = DataConnection.__init__

    def close_then(self: DataConnection, *arguments: Any) -> None:
        connect(self, *arguments)
        board.close()

    monkeypatch.setattr(DataConnection, "__init__", close_then)
    assert type(_begun(lambda: OPENED[what](board))()) is BoardClosed


@pytest.mark.parametrize("newest", [False, True])
def test_a_board_that_is_closed_just_before_its_stream_looks_for_a_frame_is_closed(
    silent: Silent, newest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by another thread, between two steps of this one."""
    board = Board(runtime_dir=silent.folder)
    stream = board.stream("camera", timeout=None, newest=newest)
    opening = _begun(stream.open)
    silent.asked().send(packets.Descriptor(kind=packets.STOPPED).pack())
    assert opening() is None
    take, receive = DataConnection.take, DataConnection.receive

    def close_then(self: DataConnection) -> Any:
        board.close()
        return take(self)

    monkeypatch.setattr(DataConnection, "take", close_then)
    if newest:  # behind the frame that read() was given
        monkeypatch.setattr(
            DataConnection, "receive", lambda self, flags=0: receive(self, flags) if flags else object()
        )
    with pytest.raises(BoardClosed):
        stream.read() if newest else stream.poll()


@pytest.mark.parametrize("what", OPENED_ASYNC)
def test_closing_a_board_of_an_event_loop_frees_the_task_that_waits_for_the_managers_answer(
    silent: Silent, what: str
) -> None:
    async def course() -> None:
        board = aio.Board(runtime_dir=silent.folder)
        waiting = asyncio.ensure_future(OPENED_ASYNC[what](board))
        try:
            await asyncio.to_thread(silent.asked)
            await board.close()
            with pytest.raises(BoardClosed):
                await asyncio.wait_for(waiting, HUNG)
        finally:
            silent.close()  # frees what is left in a thread, for which the loop would wait

    asyncio.run(course())


def test_closing_a_board_of_an_event_loop_frees_the_task_that_waits_for_a_frame(silent: Silent) -> None:
    async def course() -> None:
        board = aio.Board(runtime_dir=silent.folder)
        stream = board.stream("camera", timeout=None)
        opening = asyncio.ensure_future(stream.open())
        (await asyncio.to_thread(silent.asked)).send(packets.Descriptor(kind=packets.STOPPED).pack())
        await opening
        waiting = asyncio.ensure_future(stream.read())
        await asyncio.sleep(0)  # it waits now: nothing has come
        await board.close()
        with pytest.raises(BoardClosed):
            await asyncio.wait_for(waiting, HUNG)

    asyncio.run(course())


def test_closing_a_board_of_an_event_loop_frees_the_task_that_listens(silent: Silent) -> None:
    async def course() -> None:
        board = aio.Board(runtime_dir=silent.folder)
        waiting = asyncio.ensure_future(board.subscribe(b"cm_status").receive(None))
        await asyncio.sleep(0)
        await board.close()
        with pytest.raises(BoardClosed):
            await asyncio.wait_for(waiting, HUNG)

    asyncio.run(course())


def test_things_that_live_may_be_added_while_others_go_through_them() -> None:
    class Thing:
        pass

    living, things = Living(), [Thing(), Thing()]
    living.add(things[0])
    for thing in living:
        assert thing is things[0]
        living.add(things[1])
    del thing
    del things[0]
    assert list(living) == things
