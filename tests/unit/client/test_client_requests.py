# SPDX-License-Identifier: Apache-2.0
"""What the methods of both boards ask of a manager, and what `connect` was given: a manager that the test plays."""

from __future__ import annotations

import asyncio
import inspect
import os
import queue
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from manager_process import short_folder

from cm.client import aio, request_reply
from cm.client.aio import request_reply as aio_request_reply
from cm.client.aio.relay import Relay
from cm.client.aio.waiting import within
from cm.client.board import Board
from cm.client.core import calls
from cm.client.errors import NoAnswer, RequestBusy
from cm.client.find_manager import Keys
from cm.errors import InvalidRequest, Timeout
from cm.wire.decode import decode_request
from cm.wire.encode import encode_reply
from cm.wire.messages import requests as rq
from cm.wire.messages.status import (
    ConfigInfo,
    ErrorInfo,
    FrameInfo,
    InterruptInfo,
    Irq,
    LeaseInfo,
    MemoryInfo,
    RegisterInfo,
    RegValue,
    RegValues,
    Reply,
    Status,
    StreamStatus,
)  # fmt: skip

HUNG = 60.0
STREAM = StreamStatus("camera", "dma0", "s2mm")


class Manager:
    """The socket for requests."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], address: str, secret: bytes = b"") -> None:
        self._socket = context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVTIMEO, int(HUNG * 1000))
        if secret:
            self._socket.curve_server = True
            self._socket.curve_secretkey = secret
        self._socket.bind(address)
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self._envelope: list[bytes] = []

    def asked(self) -> rq.Request:
        """The next request."""
        frames = self._socket.recv_multipart()
        cut = frames.index(b"", 1) + 1
        self._envelope, request = frames[:cut], decode_request(frames[cut:])
        return request

    @property
    def named(self) -> list[bytes]:
        """What stood between its number and the empty frame."""
        return self._envelope[2:-1]

    def answer(self, body: Any = None, *payload: bytes, error: tuple[str, str] | None = None) -> None:
        reply = Reply(body, ErrorInfo(*error) if error else None, payload=payload)
        self._socket.send_multipart([*self._envelope, *map(bytes, encode_reply(b"cm", reply))])

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager() -> Iterator[Manager]:
    with short_folder() as folder, zmq.Context() as context:
        made = Manager(context, f"ipc://{folder}/req")
        yield made
        made.close()


def blocking(use: Callable[[Any], Any], where: str, timeout: float = HUNG, **options: Any) -> Any:
    with Board(where.removeprefix("ipc://").removesuffix("/req"), timeout=timeout, **options) as board:
        result = use(board)
        return asyncio.run(result) if inspect.iscoroutine(result) else result


def on_a_loop(use: Callable[[Any], Any], where: str, timeout: float = HUNG, **options: Any) -> Any:
    async def course() -> Any:
        board = aio.Board(where.removeprefix("ipc://").removesuffix("/req"), timeout=timeout, **options)
        try:
            result = use(board)
            return await result if inspect.isawaitable(result) else result
        finally:
            await board.close()

    return asyncio.run(course())


def over_a_relay(_: Callable[[Any], Any], where: str, keys: Keys) -> Any:
    async def course() -> Any:
        relay = Relay(where, keys=keys)
        try:
            return await relay.ask(calls.status(), timeout=HUNG)
        finally:
            await relay.close()

    return asyncio.run(course())


def begun(call: Callable[..., Any], *arguments: Any, **options: Any) -> Callable[[], Any]:
    """Call in a thread of its own; what comes of it."""
    ends: queue.Queue[tuple[Any, BaseException | None]] = queue.Queue()

    def run() -> None:
        try:
            ends.put((call(*arguments, **options), None))
        except BaseException as error:  # noqa: BLE001 (raised again where it is waited for)
            ends.put((None, error))

    def result() -> Any:
        value, error = ends.get(timeout=HUNG)
        if error is not None:
            raise error
        return value

    threading.Thread(target=run, daemon=True).start()
    return result


BOTH = pytest.mark.parametrize("client", [blocking, on_a_loop], ids=["blocking", "asyncio"])
ASKED: list[tuple[Callable[[Any], Any], rq.Request]] = [
    (lambda b: b.clients(), rq.ReadStatus(clients=True)),
    (lambda b: b.break_lease(3), rq.BreakLease(3)),
    (lambda b: b.config("camera"), rq.ReadConfig("camera")),
    (lambda b: b.config_entries(), rq.ListConfigs()),
    (lambda b: b.remove_config("camera", "l"), rq.RemoveConfig("camera", "l")),
    (
        lambda b: b.load("camera", "edge", progress=False, queue=False, force=True, lease="l"),
        rq.ChangeMode("camera", "edge", no_queue=True, force=True, lease="l"),
    ),
    (
        lambda b: b.load_async("camera", "edge", queue=False, force=True, lease="l"),
        rq.ChangeMode("camera", "edge", no_wait=True, no_queue=True, force=True, lease="l"),
    ),
    (lambda b: b.load_async("camera", "edge"), rq.ChangeMode("camera", "edge", no_wait=True)),
    (lambda b: b.set_mode("edge", lease="l"), rq.ChangeMode("", "edge", lease="l")),
    (lambda b: b.unload("prr0", lease="l"), rq.ChangeMode(unload="prr0", lease="l")),
    (lambda b: b.unload(), rq.ChangeMode(unload=rq.WHOLE)),
    (lambda b: b.cancel(), rq.CancelChange()),
    (lambda b: b.plan("edge", "camera"), rq.PlanChange("camera", "edge")),
    (lambda b: b.plan(), rq.PlanChange()),
    (lambda b: b.plan(unload=rq.WHOLE), rq.PlanChange(unload=rq.WHOLE)),
    (lambda b: b.config(), rq.ReadConfig()),
    (lambda b: b.read(), rq.ReadData("", 1.0)),
    (lambda b: b.configure_memory("table", 0x1000, 64), rq.DefineMemory("table", 0x1000, length=64)),
    (lambda b: b.check_region("prr0"), rq.CheckRegion("prr0")),
    (lambda b: b.check_region("prr0", repair=True, lease="l"), rq.CheckRegion("prr0", repair=True, lease="l")),
    (lambda b: b.check_region("prr0", reload=True), rq.CheckRegion("prr0", repair=True, reload=True)),
    (lambda b: b.map_region("prr0"), rq.MapRegion("prr0")),
    (
        lambda b: b.configure_stream(
            "to_pl", shape=[4, 5], dtype="uint16", slots=6, direction="mm2s", rate=7.0, stride=16, cyclic=True,
            backpressure=False, enable=True, force=True, lease="l",
        ),
        rq.ConfigureStream(
            "to_pl", (4, 5), dtype="uint16", slots=6, direction="mm2s", rate=7.0, cyclic=True, enable=True, force=True,
            lease="l", backpressure=False, stride=16,
        ),
    ),
    (lambda b: b.configure_stream("to_pl", automatic=True), rq.ConfigureStream("to_pl", automatic=True)),
    (
        lambda b: b.configure_memory(
            "table", 0x1000, 64, shape=(4, 4), dtype="uint32", access="ro", region="static", lease="l"
        ),
        rq.DefineMemory(
            "table", 0x1000, length=64, shape=(4, 4), dtype="uint32", access="ro", region="static", lease="l"
        ),
    ),
    (lambda b: b.write("to_pl", b"abc", "l"), rq.WriteData("to_pl", b"abc", lease="l")),
    (lambda b: b.read("camera", 0.25), rq.ReadData("camera", 0.25)),
    (lambda b: b.registers.read("focus", "zoom"), rq.ReadReg(("focus", "zoom"))),
    (lambda b: b.registers.write({"focus": 7}, "l"), rq.WriteReg((rq.RegWrite("focus", 7),), "l")),
    (lambda b: b.registers.write_masked("focus", 7, 15, "l"), rq.WriteReg((rq.RegWrite("focus", 7, mask=15),), "l")),
    (lambda b: b.memories["table"].read(8, 4), rq.ReadData("table", offset=8, length=4)),
    (lambda b: b.memories["table"].write(b"abcd", 8, "l"), rq.WriteData("table", b"abcd", lease="l", offset=8)),
    (lambda b: b.lease().take(), rq.TakeLease("board", holder=f"pid {os.getpid()}", pid=os.getpid())),
    (lambda b: b.stream("camera", copy=True).open(), rq.DescribeData("camera")),
    (lambda b: b.stream("camera", copy=True, newest=True).open(), rq.DescribeData("camera")),
]  # fmt: skip


@BOTH
@pytest.mark.parametrize(("use", "request_"), ASKED)
def test_a_method_asks_for_what_it_was_given_and_raises_the_managers_refusal(
    manager: Manager, client: Callable[..., Any], use: Callable[[Any], Any], request_: rq.Request
) -> None:
    ended = begun(client, use, manager.address)
    assert manager.asked() == request_
    assert manager.named == []
    manager.answer(error=("busy", "not now"))
    with pytest.raises(RequestBusy, match="not now"):
        ended()


@BOTH
@pytest.mark.parametrize(
    ("use", "kind"),
    [(lambda b: b.clients(), rq.ReadStatus), (lambda b: b.stream("camera").read(), rq.ReadData)],
    ids=["request", "stream"],
)
def test_a_bridge_asks_in_the_name_of_its_guest(
    manager: Manager, client: Callable[..., Any], use: Callable[[Any], Any], kind: type
) -> None:
    ended = begun(client, use, manager.address, guest="web:ann")
    assert isinstance(manager.asked(), kind)
    assert manager.named == [b"for=web:ann"]
    manager.answer(error=("busy", "not now"))
    with pytest.raises(RequestBusy):
        ended()


@BOTH
@pytest.mark.parametrize(
    ("use", "guest", "says"),
    [
        (lambda b: b.subscribe(b"cm_status"), "web:ann", "is handed to the bridge, not to 'web:ann'"),
        (lambda b: b.watch(), "web:ann", "is handed to the bridge, not to 'web:ann'"),
        (lambda b: b.writer("to_pl"), "web:ann", "a writer needs the manager's data socket, which knows no guests"),
        (lambda b: b.writer("to_pl"), "", "a writer needs the manager's data socket, which only its own machine has"),
        (lambda b: b.registers.window("edge"), "", "a window needs the manager's data socket, which only"),
        (lambda b: b.echo(64), "", "an echo needs the manager's data socket"),
        (lambda b: b.allocate(64), "", "memory for the PL needs the manager's data socket"),
        (lambda b: b.set_mode(None), "", "a mode is named by a word, not None"),
        (lambda b: b.clients(), "a\nb", "a name of at most 64 characters, all printable"),
    ],
)
def test_what_a_guest_and_a_client_of_another_machine_cannot_have_is_refused(
    manager: Manager, client: Callable[..., Any], use: Callable[[Any], Any], guest: str, says: str
) -> None:
    with pytest.raises(InvalidRequest, match=says):
        begun(client, use, manager.address, guest=guest)()


class Asked(Exception):
    """How long the answer to a request would be waited for."""


@BOTH
@pytest.mark.parametrize(
    ("use", "short", "long"),
    [
        (lambda b: b.configs if isinstance(b, Board) else b.configs(), 2.0, 70.0),
        (lambda b: b.ask(calls.status(), 3.0), 3.0, 3.0),
        (lambda b: b.load("camera"), None, None),
        (lambda b: b.load("camera", timeout=3.0), 3.0, 3.0),
        (lambda b: b.set_mode("edge", timeout=3.0), 3.0, 3.0),
        (lambda b: b.load_async("camera"), 2.0, 70.0),
        (lambda b: b.plan("edge"), 30.0, 70.0),
        (lambda b: b.map_region("prr0"), 30.0, 70.0),
        (lambda b: b.remove_config("camera"), 60.0, 70.0),
        (lambda b: b.check_region("prr0"), 60.0, 70.0),
        (lambda b: b.check_region("prr0", timeout=3.0), 3.0, 3.0),
        (lambda b: b.provision(__file__), 60.0, 70.0),
        (lambda b: b.write("to_pl", b"abc"), 7.0, 75.0),
        (lambda b: b.read("camera", 3.0), 5.0, 73.0),
    ],
)
def test_how_long_an_answer_is_waited_for(
    manager: Manager, monkeypatch: pytest.MonkeyPatch, client: Any, use: Any, short: float | None, long: float | None
) -> None:
    """Of a board that waits 2 s for other answers, and of one that waits 70 s."""

    def ask(_: Any, __: Any, timeout: float | None, *___: Any) -> Any:
        raise Asked(timeout)

    for link in (request_reply.Link, aio_request_reply.Link):
        monkeypatch.setattr(link, "ask", ask)
    for board_waits, found in ((2.0, short), (70.0, long)):
        with pytest.raises(Asked, match=f"^{found}$"):
            client(use, manager.address, board_waits)


async def now(value: Any) -> Any:
    """What both boards give: the one at once, the other when it is awaited."""
    return await value if inspect.isawaitable(value) else value


@BOTH
def test_a_lease_goes_along_with_what_its_board_asks_until_it_is_given_back(
    manager: Manager, client: Callable[..., Any]
) -> None:
    async def course(board: Any) -> None:
        lease = board.lease("region:prr0", exclusive=False, seconds=7.0, holder="me")
        with pytest.raises(InvalidRequest, match="the lease on region:prr0 is not held"):
            await now(lease.renew())
        assert await now(lease.take()) == lease.id == "x"
        await now(lease.renew())
        await now(board.remove_config("camera"))
        await now(board.remove_config("camera", "other"))
        await now(lease.release())
        await now(lease.release())  # twice is fine
        await now(board.remove_config("camera"))

    ended = begun(client, course, manager.address)
    held, listed = LeaseInfo("x", "region:prr0", exclusive=False, seconds=7.0), ConfigInfo()
    expected: list[tuple[rq.Request, Any]] = [
        (rq.TakeLease("region:prr0", exclusive=False, seconds=7.0, holder="me", pid=os.getpid()), held),
        (rq.RenewLease("x", 7.0), held),
        (rq.RemoveConfig("camera", "x"), listed),
        (rq.RemoveConfig("camera", "other"), listed),
        (rq.ReleaseLease("x"), held),
        (rq.RemoveConfig("camera"), listed),
    ]
    for request, answer in expected:
        assert manager.asked() == request
        manager.answer(answer)
    ended()


@BOTH
def test_registers_are_answered_by_name(manager: Manager, client: Callable[..., Any]) -> None:
    async def course(board: Any) -> list[Any]:
        read = await now(board.registers.read("focus", "zoom"))
        written = await now(board.registers.write({"focus": 3}))
        masked = await now(board.registers.write_masked("focus", 1, 1))
        return [read, written, written.generation, masked]

    ended = begun(client, course, manager.address)
    for values in ((("focus", 7), ("zoom", 2)), (("focus", 3),), (("focus", 5),)):
        manager.asked()
        manager.answer(RegValues(tuple(RegValue(*value) for value in values), "camera", "edge", 11))
    assert ended() == [{"focus": 7, "zoom": 2}, {"focus": 3}, 11, 5]


def _pretty(board: Any) -> str:
    """As IPython shows it in a terminal, and print anywhere."""
    said: list[str] = []
    board._repr_pretty_(SimpleNamespace(text=said.append), False)
    return "".join(said)


IRQS = ConfigInfo("camera", mode="edge", interrupts=(InterruptInfo("done"), InterruptInfo("lost")))
VALUES = RegValues((RegValue("focus", 7), RegValue("zoom", 2)), "camera", "edge", 11)
HELD = ConfigInfo(
    "camera",
    mode="edge",
    registers=(RegisterInfo("focus", 0x1000, 32, "rw"), RegisterInfo("zoom", 0x1004, 32, "wo")),
    memories=(MemoryInfo("table", 0x2000, 64), MemoryInfo("log", 0x3000, 64, modes=("default",))),
)


@pytest.mark.parametrize(
    ("use", "answers", "found"),
    [
        (lambda b: list(b.interrupts), [IRQS] * 2, ["done", "lost"]),
        (lambda b: ("done" in b.interrupts, "dome" in b.interrupts), [IRQS] * 2, (True, False)),
        (lambda b: (len(b.interrupts), b.interrupts.names), [IRQS] * 2, (2, ("done", "lost"))),
        (lambda b: b.interrupts._ipython_key_completions_(), [IRQS], ["done", "lost"]),
        (lambda b: b.interrupts["done"].count, [Irq("done", 5, 9)], 5),
        (lambda b: list(b.registers), [HELD] * 2, ["focus", "zoom"]),
        (lambda b: len(b.registers), [HELD], 2),
        (lambda b: b.registers.update({"focus": 7}, zoom=2), [VALUES], None),
        (lambda b: b.registers.update(zoom=2), [VALUES], None),
        (lambda b: b.registers.update(), [], None),
        (lambda b: b.registers._ipython_key_completions_(), [HELD], ["focus", "zoom"]),
        (lambda b: [n for n in dir(b.registers) if n in ("focus", "zoom", "read")], [HELD], ["focus", "read", "zoom"]),
        (lambda b: ">7<" in b.registers._repr_html_(), [HELD, VALUES], True),
        (lambda b: list(b.memories), [HELD] * 2, ["table"]),
        (lambda b: (len(b.memories), "log" in b.memories), [HELD] * 2, (1, False)),
        (lambda b: b.memories._ipython_key_completions_(), [HELD], ["table"]),
        (lambda b: "camera/edge" in b._repr_html_(), [Status("camera", "edge")], True),
        (lambda b: "camera/edge" in _pretty(b), [Status("camera", "edge")], True),
    ],
)
def test_what_the_blocking_client_has_is_a_mapping_of_what_the_manager_says(
    manager: Manager, use: Any, answers: list[Any], found: Any
) -> None:
    ended = begun(blocking, use, manager.address)
    for answer in answers:
        manager.asked()
        manager.answer(answer)
    assert ended() == found


@BOTH
def test_a_memory_asks_for_what_it_needs_of_itself(manager: Manager, client: Callable[..., Any]) -> None:
    async def course(board: Any) -> list[Any]:
        table = board.memories["table"]
        info = table.info if client is blocking else await table.info()
        found = [(await now(read)).tolist() for read in (table.get(slice(1, 3)), table.read(60), table.read(8, 4))]
        await now(table.put(slice(1, 2), [7], "l"))
        return [info.size, *found, await now(table.write(b"abcd", 8, "l")), await now(table.write([9]))]

    ended = begun(client, course, manager.address)
    info, describe = MemoryInfo("table", 0x2000, 64), rq.DescribeData("table")
    expected: list[tuple[rq.Request, Any]] = [(describe, info), (describe, info)]
    for offset, length in ((4, 8), (60, 4), (8, 4)):
        expected += [(describe, info)] * (offset == 60)
        part = FrameInfo("table", 0, 0, length, (length // 4,), "uint32")
        expected.append((rq.ReadData("table", offset=offset, length=length), (part, bytes(range(1, length + 1)))))
    written = FrameInfo("table", 0, 0, 4)
    expected += [
        (describe, info),
        (describe, info),
        (rq.WriteData("table", b"\x07\0\0\0", lease="l", offset=4), written),
    ]
    expected += [(rq.WriteData("table", b"abcd", lease="l", offset=8), written)]
    expected += [(describe, info), (rq.WriteData("table", b"\x09\0\0\0"), written)]
    for request, answer in expected:
        assert manager.asked() == request
        manager.answer(*(answer if type(answer) is tuple else (answer,)))
    assert ended() == [64, [0x04030201, 0x08070605], [0x04030201], [0x04030201], 4, 4]


@BOTH
def test_what_is_shown_of_a_board_and_its_parts(manager: Manager, client: Callable[..., Any]) -> None:
    async def course(board: Any) -> list[str]:
        irqs, memories = board.interrupts, board.memories
        parts = (board, board.registers, irqs, irqs["done"], memories, memories["a"], board.stream("camera", copy=True))
        shown = [repr(part) for part in parts]
        await now(board.close())
        return [*shown, repr(board)]

    itself = f"<board at {manager.address}>"
    parts = [f"<{part} of {itself}>" for part in ("registers", "interrupts", "memories")]
    closed = itself.replace(">", ", closed>")
    expected = [itself, *parts[:2], "<interrupt done>", parts[2], "<Memory a>", "<stream camera>", closed]
    assert client(course, manager.address) == expected


@BOTH
def test_a_board_waits_for_answers_as_long_as_it_was_told(manager: Manager, client: Callable[..., Any]) -> None:
    assert begun(client, lambda board: board.timeout, manager.address, timeout=0.125)() == 0.125
    ended = begun(client, lambda board: board.clients(), manager.address, timeout=0.125)
    with pytest.raises(NoAnswer, match=rf"at {manager.address} within 0\.125 s"):
        ended()
    left = Path(manager.address.removeprefix("ipc://"))
    left.unlink()
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(left))
    with pytest.raises(NoAnswer, match="nobody serves that socket any more, the manager was killed"):
        client(lambda board: board.clients(), manager.address, timeout=0.125)


@BOTH
def test_a_stream_waits_for_published_frames_as_long_as_it_was_told(
    manager: Manager, client: Callable[..., Any]
) -> None:
    ended = begun(client, lambda board: board.stream("camera", 0.125, copy=True).read(), manager.address)
    assert manager.asked() == rq.DescribeData("camera")
    manager.answer(STREAM)
    with pytest.raises(Timeout, match=r"'camera' gave no frame within 0\.125 s"):
        ended()


@BOTH
def test_a_stream_asks_for_the_newest_frame_for_as_long_as_it_was_told(
    manager: Manager, client: Callable[..., Any]
) -> None:
    ended = begun(client, lambda board: board.stream("camera", 3.0, newest=True, copy=True).read(), manager.address)
    asked = manager.asked()
    assert isinstance(asked, rq.ReadData)
    assert 0 < asked.timeout <= 3.0
    manager.answer(error=("busy", "not now"))
    with pytest.raises(RequestBusy):
        ended()


@BOTH
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"depth": -1, "copy": True}, "a stream of depth -1"),
        ({"timeout": "5", "copy": True}, "a number of seconds, or None"),
    ],
)
def test_what_no_stream_can_be_is_refused_before_anything_is_asked(
    manager: Manager, client: Callable[..., Any], options: dict[str, Any], says: str
) -> None:
    with pytest.raises(InvalidRequest, match=says):
        begun(client, lambda board: board.stream("camera", **options), manager.address)()


def test_what_cannot_be_done_in_this_way_says_in_which(manager: Manager) -> None:
    """By the blocking client, and by the asyncio one."""

    def delete(board: Any) -> None:
        del board.registers["focus"]

    with pytest.raises(TypeError, match=r"^a register cannot be deleted$"):
        blocking(delete, manager.address)
    (Path(manager.address.removeprefix("ipc://")).parent / "data").touch()
    with pytest.raises(InvalidRequest, match=r"^enter the writer first: async with board\.writer\(…\) as writer$"):
        on_a_loop(lambda board: board.writer("to_pl").write(b"abc"), manager.address)


@pytest.mark.parametrize("client", [blocking, on_a_loop, over_a_relay], ids=["blocking", "asyncio", "relay"])
def test_a_client_with_keys_is_let_in_where_keys_are_needed(client: Callable[..., Any]) -> None:
    (server, server_secret), (public, secret) = zmq.curve_keypair(), zmq.curve_keypair()
    with zmq.Context() as context:
        manager = Manager(context, "tcp://127.0.0.1:*", server_secret)
        host, _, port = manager.address.rpartition(":")
        where = f"{host}:{int(port) - 2}"  # the socket for requests has the third of three ports
        ended = begun(client, lambda board: board.run(_status()), where, keys=Keys(server, public, secret))
        assert manager.asked() == rq.ReadStatus()
        manager.answer(Status("camera", "edge"))
        assert ended().mode == "edge"
        manager.close()


def test_a_task_that_is_cancelled_with_its_reply_is_cancelled() -> None:
    async def main() -> None:
        waiting: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        task = asyncio.ensure_future(within(waiting, 60.0))
        await asyncio.sleep(0)
        waiting.set_result(1)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())


def _status() -> Any:
    return (yield calls.status())
