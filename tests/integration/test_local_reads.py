# SPDX-License-Identifier: Apache-2.0
"""Registers that local clients read over the data socket, without a request: what is read is what a request reads."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from client_twins import connected
from manager_process import CAMERA, Manager, environment, patient, served, stalled, until

import cm
import cm.aio
from cm.client.errors import NoAnswer, RequestBusy, RequestFailed, RequestNotFound
from cm.simulation.software import Board as SimBoard
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import DESCRIPTOR, Descriptor

IDENTITIES = {"of_edge": 0xCA3E0002, "of_colorise": 0xCA3E0003}
READS = 20_000
OWN_NAME = "            of_%s: {offset: 0x1000, access: ro, volatile: true}\n"


def reads_without_requests(manager: Manager, read: Callable[[], Any]) -> bool:
    """Whether this process can read many times with no request; `read` may have to be called a few times before."""
    with manager.connected() as observer:

        def requests() -> int:
            return sum(client.requests for client in observer.clients())

        before = requests()
        for _ in range(20):
            read()
        return requests() - before == 1


def local(manager: Manager, board: Any, name: str = "led") -> Any:
    """A board whose reads need no requests by now."""
    until(lambda: reads_without_requests(manager, lambda: board.registers.read(name)))
    return board


@pytest.fixture(params=["blocking", "asyncio"])
def reader(request: pytest.FixtureRequest, board: cm.Board, manager: Manager) -> Iterator[Any]:
    """A client of its own, of both kinds; the board is in the example's default mode."""
    with connected(request.param, runtime_dir=manager.runtime, timeout=60) as made:
        yield local(manager, made)


# ---- values ------------------------------------------------------------------------------


def test_a_value_is_the_one_that_a_request_reads(reader: Any, board: cm.Board, manager: Manager) -> None:
    board.registers.write({"led": 0x2A, "scratch": 0xFFFFFFFF, "focus": 9})
    for name in ("led", "led.blink", "led.pattern", "scratch", "focus", "ident", "version"):
        local(manager, reader, name)
        by_request = reader.registers.read("led", name)[name]  # several registers are one request
        assert reader.registers.read(name) == {name: by_request}
        assert reader.registers.get(name) == by_request


def test_an_error_is_the_one_of_a_request(reader: Any) -> None:
    for name in ("fokus", "led.blank", "threshold"):
        for _ in range(5):
            with pytest.raises(RequestNotFound):
                reader.registers.read(name)
        assert reader.registers.get(name, 7) == 7
    for name in ("", "a" * 300, "\udc80", "led\0"):  # which none can have
        for _ in range(3):
            with pytest.raises((RequestFailed, cm.errors.InvalidRequest, UnicodeEncodeError, ValueError)):
                reader.registers.read(name)
    assert reader.registers.read("led")


# ---- order ---------------------------------------------------------------------------------


def test_a_read_sees_the_write_before_it_whoever_made_it(reader: Any, board: cm.Board) -> None:
    for value in range(64):
        (reader if value % 2 else board).registers.write({"led": value})
        assert reader.registers.read("led") == {"led": value}


def test_a_read_sees_the_change_of_mode_before_it(reader: Any) -> None:
    for mode, name in (("edge_detection", "threshold"), ("colorise", "palette")) * 3:
        reader.set_mode(mode)
        assert reader.registers.read(name) == {name: 0}
        other = "palette" if name == "threshold" else "threshold"
        with pytest.raises(RequestNotFound):
            reader.registers.read(other)


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Manager, SimBoard]]:
    """A board whose port can be stalled for as long as a test wants."""
    with served(schemas=patient(tmp_path_factory.mktemp("camera"))) as both:
        yield both


@pytest.mark.parametrize("kind", ["blocking", "asyncio"])
def test_a_read_waits_behind_a_write_that_was_given_up(slow: tuple[Manager, SimBoard], kind: str) -> None:
    """The write waits for the change before it; the read would see the value before both otherwise."""
    manager, sim = slow
    with connected(kind, runtime_dir=manager.runtime, timeout=60) as board:
        board.load("camera", "default", force=True)
        local(manager, board, "zoom")
        with stalled(sim):
            board.load_async(mode="edge_detection")
            board.timeout = 0.2
            with pytest.raises(NoAnswer):
                board.registers.write({"zoom": 5})
            board.timeout = 60
        assert board.registers.read("zoom") == {"zoom": 5}
        local(manager, board, "zoom")


def test_a_task_reads_behind_its_own_write(slow: tuple[Manager, SimBoard]) -> None:
    manager, sim = slow

    async def use() -> int:
        async with await cm.aio.connect(runtime_dir=manager.runtime, timeout=60) as board:
            await board.load("camera", "default", force=True)
            for _ in range(40):
                await board.registers.read("zoom")
            with stalled(sim):
                await board.load_async(mode="edge_detection")
                write = asyncio.ensure_future(board.registers.write({"zoom": 6}))
                await asyncio.sleep(0)
                read = asyncio.ensure_future(board.registers.read("zoom"))
                await asyncio.sleep(0)
            await write
            return (await read)["zoom"]

    assert asyncio.run(use()) == 6


def test_a_region_that_is_changed_is_not_read(slow: tuple[Manager, SimBoard]) -> None:
    manager, sim = slow
    with manager.connected() as other, manager.connected() as board:
        board.load("camera", "default", force=True)
        local(manager, board, "focus")
        with stalled(sim):
            change = other.load_async(mode="edge_detection")
            until(lambda: other.status.progress is not None and other.status.progress.step == "load")
            for _ in range(20):
                with pytest.raises(RequestBusy):
                    board.registers.read("focus")
                assert board.registers.read("led")
        change.wait()
        assert board.registers["focus"] == 1


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Manager]:
    """Each module has a name of its own for the register with its identity, which all have at the same place."""
    lines = re.compile(r"^        ident:\n(          .*\n)*", re.MULTILINE)
    text, removed = lines.subn("", (CAMERA / "camera.yaml").read_text())
    for module in ("edge", "colorise"):
        head = re.compile(rf"^    {module}:\n(?:      .*\n)*?          registers:\n", re.MULTILINE)
        text, added = head.subn(r"\g<0>" + OWN_NAME % module, text)
        assert (removed, added) == (1, 1)
    folder = tmp_path_factory.mktemp("named")
    (folder / "camera.yaml").write_text(text)
    with served(schemas=folder) as (manager, _):
        yield manager


def identity_reads(manager: Manager, reads: int, pause: float = 0.02) -> dict[str, int]:
    """Reads of the modules' identities by their own names, under changes; how many gave a value."""
    over = threading.Event()

    def change() -> None:
        with manager.connected() as other:
            while not over.is_set():
                for mode in ("edge_detection", "colorise"):
                    other.mode = mode
                    over.wait(pause)  # some of a mode's reads are behind one another without a change

    found = dict.fromkeys(IDENTITIES, 0)
    with manager.connected() as board:
        board.load("camera", "edge_detection")
        changes = threading.Thread(target=change)
        changes.start()
        try:
            while sum(found.values()) < reads or not all(found.values()):  # a slow machine changes seldom
                for name, identity in IDENTITIES.items():
                    try:
                        while True:
                            value = board.registers[name]
                            assert value == identity, f"{name} reads {value:#x}"
                            found[name] += 1
                    except RequestFailed:  # of another mode, or being changed
                        pass
        finally:
            over.set()
            changes.join()
    return found


def test_no_read_is_of_another_module(named: Manager) -> None:
    assert all(identity_reads(named, READS).values())


# ---- whom it serves --------------------------------------------------------------------------


def raw(manager: Manager, *sent: bytes) -> socket.socket:
    """A connection that keeps to no rules."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    connection.settimeout(60)
    connection.connect(str(manager.runtime / packets.SOCKET))
    connection.send(packets.encode_open(packets.Open("", packets.Purpose.REGISTERS)))
    for packet in sent:
        connection.send(packet)
    return connection


def received(connection: socket.socket) -> Descriptor:
    return Descriptor(*DESCRIPTOR.unpack_from(connection.recv(packets.PACKET_MAX)))


def test_one_who_reads_nothing_holds_nobody_up(reader: Any, manager: Manager) -> None:
    with raw(manager) as connection:
        connection.setblocking(False)
        ask = Descriptor(kind=packets.READ).pack() + b"led"

        def hung_up() -> bool:
            try:
                connection.send(ask)
            except BlockingIOError:
                return False
            except OSError:
                return True
            return False

        until(hung_up)
    assert reader.registers.read("led")


def descriptors(manager: Manager) -> int:
    return len(list(Path(f"/proc/{manager.pid}/fd").iterdir()))


def test_a_user_has_so_many_and_one_more_goes_by_requests(board: cm.Board, manager: Manager) -> None:
    def taken() -> bool:
        """Whether all of them are; those that were closed before make room a moment later."""
        held = [stack.enter_context(raw(manager)) for _ in range(96)]
        kinds = {received(connection).kind for connection in held}
        if kinds != {packets.REGISTERS}:
            stack.close()
        return kinds == {packets.REGISTERS}

    with ExitStack() as stack:
        until(taken)
        with raw(manager) as connection:
            assert received(connection).kind == packets.REFUSED
        assert {board.registers["led"] for _ in range(40)} == {board.registers["led"]}
    local(manager, board)


CLIENT = """
import sys, time
import cm
boards = [cm.connect(runtime_dir=sys.argv[1], timeout=60) for _ in range(8)]
for board in boards:
    for _ in range(40):
        board.registers["led"]
print("read", flush=True)
while True:
    board.registers["led"]
"""


def test_a_killed_client_leaves_nothing(board: cm.Board, manager: Manager) -> None:
    before = descriptors(manager)
    command = [sys.executable, "-c", CLIENT, str(manager.runtime)]
    with subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "read\n"
        process.kill()
    until(lambda: descriptors(manager) <= before)
    assert board.registers["led"] >= 0


def test_threads_share_a_board(board: cm.Board, manager: Manager) -> None:
    board.registers.write({"led": 5, "scratch": 77})
    local(manager, board)
    wrong = []

    def read(name: str, value: int) -> None:
        wrong.extend(found for _ in range(500) if (found := board.registers[name]) != value)

    threads = [threading.Thread(target=read, args=each) for each in (("led", 5), ("scratch", 77)) * 2]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@contextmanager
def interrupted(handler: Callable[[], object]) -> Iterator[None]:
    """Again and again, by a signal handler."""

    def soon(*_: object) -> None:
        signal.setitimer(signal.ITIMER_REAL, 0.001)

    def now(*_: object) -> None:
        handler()
        soon()

    before = signal.signal(signal.SIGALRM, now)
    try:
        soon()
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_a_read_after_one_that_an_exception_ended_has_its_own_answer(board: cm.Board, manager: Manager) -> None:
    values = {"led": 5, "scratch": 77}
    board.registers.write(values)
    local(manager, board)
    ended = 0

    class Ended(Exception):
        pass

    def end() -> None:
        raise Ended

    while ended < 200:
        try:
            with interrupted(end):
                while True:
                    for name, value in values.items():
                        assert board.registers[name] == value
        except Ended:
            ended += 1
    assert {name: board.registers[name] for name in values} == values
    local(manager, board)


def test_a_signal_handler_reads_within_a_read(board: cm.Board, manager: Manager) -> None:
    values = {"led": 5, "scratch": 77}
    board.registers.write(values)
    local(manager, board)
    found = []
    with interrupted(lambda: found.append(board.registers["scratch"])):
        while len(found) < 20:
            assert board.registers["led"] == 5
    assert set(found) == {77}


def test_a_manager_that_is_stopped_answers_no_read_and_one_that_goes_on_does(own: tuple[Manager, SimBoard]) -> None:
    manager, _ = own
    with manager.connected() as board:
        board.load("camera", "default")
        local(manager, board)
        os.kill(manager.pid, signal.SIGSTOP)
        try:
            tasks = list(Path(f"/proc/{manager.pid}/task").iterdir())
            until(lambda: all((t / "stat").read_text().rpartition(")")[2].split()[0] == "T" for t in tasks))
            board.timeout = 0.2
            with pytest.raises(NoAnswer):
                _ = board.registers["led"]
        finally:
            os.kill(manager.pid, signal.SIGCONT)
        board.timeout = 60
        local(manager, board)


def test_reads_go_on_with_the_next_manager(own: tuple[Manager, SimBoard]) -> None:
    manager, _ = own
    with manager.connected() as board:
        board.load("camera", "default")
        board.registers["led"] = 9
        local(manager, board)
        manager.kill()
        manager.start()
        until(lambda: _led(board) == 9)
        local(manager, board)


def _led(board: cm.Board) -> int | None:
    try:
        return board.registers["led"]
    except cm.errors.CmError:
        return None
