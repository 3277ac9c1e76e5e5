# SPDX-License-Identifier: Apache-2.0
"""The server of `cm web` as programs see it: who is admitted, who may change what, and what many pages cost."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import aiohttp
import pytest
from manager_process import REPOSITORY, Manager, environment, served, until
from web_support import WebServer, web_server

import cm
from cm.simulation.software import Board as SimBoard

pytestmark = pytest.mark.web
HUNG = 60.0
Session = Callable[[], Awaitable[None]]


@pytest.fixture(scope="module")
def camera() -> Iterator[tuple[Manager, SimBoard]]:
    with served() as both:
        with both[0].connected() as board:
            board.load("camera", "default")
        yield both


@pytest.fixture(scope="module")
def looking(camera: tuple[Manager, SimBoard]) -> Iterator[WebServer]:
    with web_server(camera[0].runtime) as server:
        yield server


@pytest.fixture(scope="module")
def controlling(camera: tuple[Manager, SimBoard]) -> Iterator[WebServer]:
    with web_server(camera[0].runtime, "--control") as server:
        yield server


class Page:
    """The WebSocket of a page, without a page."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.topics: dict[str, Any] = {}
        self.pictures = 0
        self.replies: dict[int, dict[str, Any]] = {}

    async def take(self) -> None:
        message = await self.socket.receive(HUNG)
        assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
        if message.type is aiohttp.WSMsgType.BINARY:
            (length,) = struct.unpack_from("<H", message.data)
            self.pictures += 1
            await self.socket.send_json({"drawn": json.loads(message.data[2 : 2 + length])["stream"]})
            return
        found = json.loads(message.data)
        self.replies.update({found["reply"]: found} if "reply" in found else {})
        self.topics.update(found)

    async def until(self, condition: Callable[[], Any]) -> Any:
        while not (value := condition()):
            await self.take()
        return value

    async def ask(self, number: int, what: Any, **words: Any) -> dict[str, Any]:
        await self.socket.send_json({"do": what, "id": number, "with": words})
        found: dict[str, Any] = await self.until(lambda: self.replies.get(number))
        return found


@asynccontextmanager
async def page(server: WebServer) -> AsyncIterator[Page]:
    async with aiohttp.ClientSession() as client, client.ws_connect(f"{server.origin}/ws") as socket:
        await socket.send_json({"token": server.token})
        made = Page(socket)
        await made.until(lambda: made.topics.get("link", {}).get("up") and made.topics.get("config"))
        yield made


async def status_of(server: WebServer, path: str, **headers: str) -> tuple[int, str, dict[str, str]]:
    async with aiohttp.ClientSession() as client, client.get(f"{server.origin}{path}", headers=headers) as reply:
        return reply.status, await reply.text(), dict(reply.headers)


# ---- admission ----------------------------------------------------------------------------


def test_the_page_is_whole_without_a_network_and_may_run_nothing_else(looking: WebServer) -> None:
    status, text, headers = asyncio.run(status_of(looking, "/"))
    assert status == 200
    assert looking.token not in text
    assert "http:" not in text
    assert "https:" not in text
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    for file in ("app.js", "style.css", "icon.svg"):
        assert asyncio.run(status_of(looking, f"/{file}"))[0] == 200


@pytest.mark.parametrize("path", ["/none.js", "/..%2fserver.py", "/static/app.js", "/.hidden", "/app.py"])
def test_nothing_else_is_served(looking: WebServer, path: str) -> None:
    assert asyncio.run(status_of(looking, path))[0] == 404


def test_a_name_that_was_made_to_lead_here_is_refused(looking: WebServer) -> None:
    status, text, _ = asyncio.run(status_of(looking, "/", Host="evil.example"))
    assert (status, "--name evil.example" in text) == (421, True)
    assert asyncio.run(status_of(looking, "/ws", Host="evil.example:80", Origin="http://evil.example:80"))[0] == 421


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_page_of_others_cannot_open_the_socket(looking: WebServer, origin: str) -> None:
    async def attempt() -> int:
        async with aiohttp.ClientSession() as client:
            try:
                await client.ws_connect(f"{looking.origin}/ws", headers={"Origin": origin})
            except aiohttp.WSServerHandshakeError as error:
                return error.status
        return 101

    assert asyncio.run(attempt()) == 403


DEEP = "[" * 30_000  # more brackets than Python's stack


@pytest.mark.parametrize(
    "first",
    ['{"token": "wrong"}', "{}", "[]", "no json", '{"do": "mode"}', '{"token": null}', pytest.param(DEEP, id="deep")],
)
def test_without_the_token_nothing_is_reported(looking: WebServer, first: str) -> None:
    async def attempt() -> tuple[Any, int | None]:
        async with aiohttp.ClientSession() as client, client.ws_connect(f"{looking.origin}/ws") as socket:
            await socket.send_str(first)
            return (await socket.receive(HUNG)).type, socket.close_code

    assert asyncio.run(attempt()) == (aiohttp.WSMsgType.CLOSE, 4401)


@pytest.mark.parametrize(
    "message",
    [
        *("[]", "7", '{"watch": 3}', '{"do": "read"}', '{"do": 1, "id": "x"}', '{"do": "read", "id": 1e999}'),
        *(pytest.param("x" * 70_000, id="long"), pytest.param(DEEP, id="deep")),
    ],
)
def test_messages_that_no_page_would_send_end_only_their_own_connection(looking: WebServer, message: str) -> None:
    async def attempt() -> None:
        async with page(looking) as strange, page(looking) as good:
            await strange.socket.send_str(message)
            ends = (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED)
            while (last := (await strange.socket.receive(HUNG)).type) not in ends:
                pass
            assert last is aiohttp.WSMsgType.CLOSE, "the server says why, and does not fail at it"
            assert "error" not in await good.ask(1, "read", names=["led"])

    asyncio.run(attempt())


def test_whoever_never_says_who_they_are_keeps_nobody_out(looking: WebServer) -> None:
    """Sockets that are opened and left idle: nothing but bytes, half a request, or a page without a token."""

    async def scenario() -> None:
        host, port = looking.host.rsplit(":", 1)
        async with AsyncExitStack() as stack:
            before = await stack.enter_async_context(page(looking))
            idle = [await asyncio.open_connection(host, int(port)) for _ in range(120)]
            for _, writer in idle[::2]:
                writer.write(b"GET / HTT")
            client = await stack.enter_async_context(aiohttp.ClientSession())
            for _ in range(40):
                with suppress(aiohttp.ClientError):
                    await client.ws_connect(f"{looking.origin}/ws")
            async with page(looking) as newcomer:
                assert newcomer.topics["link"]["up"]
            await asyncio.wait_for(asyncio.gather(*(reader.read() for reader, _ in idle)), HUNG)  # all are closed
            before.topics.clear()
            assert "error" in await before.ask(1, "mode", mode="default")  # it looks only, but is answered
            for _, writer in idle:
                writer.close()

    asyncio.run(scenario())


NONE = [b"GET / HTTP/1.1\r\nno header\r\n\r\n", b"GET /" + b"a" * 9000 + b" HTTP/1.1\r\n\r\n"]


def test_requests_that_are_none_write_one_short_line_to_the_log(camera: tuple[Manager, SimBoard]) -> None:
    server = WebServer(camera[0].runtime)
    host, _, port = server.host.rpartition(":")
    for number in range(50):
        with socket.create_connection((host, int(port)), timeout=60) as stranger:
            stranger.sendall(NONE[number % 2])
            assert b"400" in stranger.recv(4096)
    status, said = server.stop()
    assert (status, len(said.splitlines())) == (0, 1), said
    assert said.startswith("Error handling request from 127.0.0.1: ")
    assert len(said) < 250


@pytest.mark.parametrize("mode", [0o604, 0o644, 0o602])
def test_a_token_that_all_may_read_is_refused(tmp_path: Path, mode: int) -> None:
    (tmp_path / "token").write_text("a token that is long")
    (tmp_path / "token").chmod(mode)
    command = [sys.executable, "-m", "cm", "web", "--token-file", str(tmp_path / "token")]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False, cwd=REPOSITORY)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"all users of this machine may read it: chmod 600 {tmp_path}/token" in done.stderr


def test_serving_beyond_this_machine_needs_tls_or_an_explicit_option(camera: tuple[Manager, SimBoard]) -> None:
    from cm.cli.main import main

    assert main(["web", "--runtime-dir", str(camera[0].runtime), "--listen", "0.0.0.0:0"]) == 1


# ---- who may change what --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("what", "words"), [("mode", {"mode": "colorise"}), ("write", {"name": "led", "value": 1}), ("cancel", {})]
)
def test_a_page_that_may_look_changes_nothing(looking: WebServer, what: str, words: dict[str, Any]) -> None:
    async def attempt() -> tuple[str, Any]:
        async with page(looking) as made:
            reply = await made.ask(1, what, **words)
            return reply["error"]["code"], made.topics["status"]["mode"]

    assert asyncio.run(attempt()) == ("read_only", "default")


def test_a_page_with_control_writes_registers_by_name_and_value(controlling: WebServer) -> None:
    async def attempt() -> None:
        async with page(controlling) as one, page(controlling) as other:
            assert "error" not in await one.ask(1, "write", name="led.blink", value="fast")
            assert "error" not in await one.ask(2, "write", name="led.pattern", value=5)
            wanted = {"pattern": 5, "blink": 2}  # it may know no values yet
            await other.until(lambda: other.topics.get("registers", {}).get("led", {}).get("fields") == wanted)

    asyncio.run(attempt())


@pytest.mark.parametrize(
    ("what", "words", "code"),
    [
        ("mode", {"config": "camera", "mode": "nowhere"}, "unknown_mode"),
        ("mode", {"mode": 3}, "invalid_request"),
        ("write", {"name": "focus", "value": 99}, "out_of_range"),
        ("write", {"name": "focus", "value": 1.5}, "invalid_request"),
        ("write", {"name": "focus", "value": True}, "invalid_request"),
        ("write", {"name": "nowhere", "value": 1}, "unknown_register"),
        ("read", {"names": "led"}, "invalid_request"),
        ("plan", {"mode": []}, "invalid_request"),
        ("format_disk", {}, "invalid_request"),
    ],
)
def test_impossible_requests_are_errors_with_their_codes(
    controlling: WebServer, what: str, words: dict[str, Any], code: str
) -> None:
    async def attempt() -> Any:
        async with page(controlling) as made:
            return (await made.ask(1, what, **words))["error"]["code"]

    assert asyncio.run(attempt()) == code


def test_a_lease_of_another_keeps_the_page_off(camera: tuple[Manager, SimBoard], controlling: WebServer) -> None:
    async def attempt() -> Any:
        async with page(controlling) as made:
            return (await made.ask(1, "mode", mode="colorise"))["error"]

    with camera[0].connected() as board, board.lease("region:prr0", holder="the test"):
        error = asyncio.run(attempt())
    assert error["code"] == "held_by"
    assert "the test" in error["message"]


# ---- streams --------------------------------------------------------------------------------


def test_any_number_of_pages_add_one_reader_to_a_stream_and_others_lose_nothing(
    camera: tuple[Manager, SimBoard], looking: WebServer
) -> None:
    async def attempt(board: cm.Board) -> None:
        async with AsyncExitStack() as stack:
            pages = [await stack.enter_async_context(page(looking)) for _ in range(8)]
            for made in pages:
                await made.socket.send_json({"watch": {"camera": "", "to_pl": "", "nowhere": ""}})
            await asyncio.gather(*[made.until(lambda made=made: made.pictures >= 10) for made in pages])
            stream = next(s for s in board.status.streams if s.name == "camera")
            assert [client.pid for client in stream.clients] == [looking.process.pid]
            assert stream.dropped == stream.clients[0].dropped  # what a loaded machine keeps from it is its own
            assert (stream.overruns, stream.errors) == (0, 0)

    with camera[0].connected() as board:
        asyncio.run(attempt(board))
        until(lambda: not any(s.clients for s in board.status.streams))


def test_a_page_that_draws_nothing_is_sent_two_pictures(looking: WebServer) -> None:
    async def attempt() -> int:
        async with page(looking) as slow, page(looking) as quick:
            for made in (slow, quick):
                await made.socket.send_json({"watch": {"camera": ""}})
            await quick.until(lambda: quick.pictures >= 20)
            await slow.socket.send_json({"do": "read", "id": 1, "with": {"names": ["led"]}})
            pictures = 0
            while not slow.replies:
                message = await slow.socket.receive(HUNG)
                pictures += message.type is aiohttp.WSMsgType.BINARY
                found = json.loads(message.data) if message.type is aiohttp.WSMsgType.TEXT else {}
                slow.replies.update({found["reply"]: found} if "reply" in found else {})
            return pictures

    assert asyncio.run(attempt()) == 2


def test_a_manager_that_starts_anew_is_found_again() -> None:
    async def attempt(manager: Manager, server: WebServer) -> None:
        async with page(server) as made:
            await made.socket.send_json({"watch": {"camera": ""}})
            await made.until(lambda: made.pictures >= 1)
            started = made.topics["status"]["started_ns"]
            await asyncio.to_thread(manager.kill)
            await made.until(lambda: not made.topics["link"]["up"])
            assert made.topics["link"]["problem"]
            assert (await made.ask(1, "read"))["error"]["code"] == "connection_lost"
            await asyncio.to_thread(manager.start)
            await made.until(lambda: made.topics["link"]["up"] and made.topics["status"]["started_ns"] != started)
            before = made.pictures
            await made.until(lambda: made.pictures > before + 2)

    with served() as (manager, _), web_server(manager.runtime) as server:
        with manager.connected() as board:
            board.load("camera", "default")
        asyncio.run(attempt(manager, server))
