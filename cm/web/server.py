# SPDX-License-Identifier: Apache-2.0
"""The page's server: its files, and a WebSocket for each page."""

from __future__ import annotations

import asyncio
import logging
import os
import ssl
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from cm.errors import InvalidRequest
from cm.web.commands import Commands
from cm.web.gate import Gate, is_loopback
from cm.web.hub import Connect, Hub
from cm.web.session import Session
from cm.web.shown_streams import Watching

if TYPE_CHECKING:
    from cm.networks.fleet.aio import Fleet

STATIC = Path(__file__).with_name("static")
_PAGES = 32  # whose users have said who they are, at once
_OF_ADDRESS, _ALTOGETHER = 16, 64  # connections of whoever has not said that yet
_FIRST = 5.0  # seconds in which a connection has to ask for something
_IDLE = 15.0  # seconds that one is kept between two requests
_LOOK = 0.5  # seconds between two looks at them
_MESSAGE = 1 << 16  # bytes of what a page sends
_LINE, _QUIET = 200, 10.0  # characters of a line about a request that is none, and seconds between two
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-cache",  # so that after an upgrade no browser uses old scripts
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Strangers:
    """Connections of whoever has not said who they are: few of an address, and none that says nothing.

    Beyond the bounds the oldest go, so that there is always room for one more who may have the token.
    """

    def __init__(self) -> None:
        self._since: dict[Any, float] = {}  # when each was seen first
        self._heard: set[Any] = set()

    def heard(self, connection: Any) -> None:
        """It has sent a request."""
        self._heard.add(connection)

    def send_off(self, connections: Iterable[Any], pages: Collection[object]) -> None:
        """Close those that are too many or too late; `pages` stay."""
        now = time.monotonic()
        of: dict[str, int] = defaultdict(int)
        strangers = [one for one in connections if one not in pages and one.transport is not None]
        self._since = {one: self._since.get(one, now) for one in strangers}
        self._heard &= self._since.keys()
        strangers.sort(key=lambda one: self._since[one], reverse=True)
        for number, one in enumerate(strangers):
            address = str((one.transport.get_extra_info("peername") or ("",))[0])
            of[address] += 1
            late = one not in self._heard and now - self._since[one] > _FIRST
            if late or of[address] > _OF_ADDRESS or number >= _ALTOGETHER:
                one.force_close()


class OneLine(logging.LoggerAdapter[logging.Logger]):
    """What aiohttp logs of requests that are none: a short line without a traceback, one in ten seconds at most."""

    def __init__(self, logger: logging.Logger) -> None:
        super().__init__(logger, {})
        self._next, self._more = 0.0, 0

    def exception(self, msg: object, *args: object, exc_info: Any = True, **words: Any) -> None:
        """As of a logger. A defect of ours comes with its traceback."""
        if not isinstance(exc_info, HttpProcessingError):
            super().exception(msg, *args, exc_info=exc_info, **words)
            return
        now = time.monotonic()
        if now < self._next:
            self._more += 1
            return
        said = f"{str(msg) % args}: {exc_info.message}".splitlines()[0][:_LINE]
        text = "".join(c if c.isprintable() else "?" for c in said)
        self.logger.warning("%s%s", text, f" ({self._more} more before it)" if self._more else "")
        self._next, self._more = now + _QUIET, 0


@dataclass(frozen=True, slots=True)
class Options:
    """Where and how to serve."""

    connect: Connect
    gate: Gate
    host: str = "127.0.0.1"
    port: int = 8080
    control: bool = False
    tls: ssl.SSLContext | None = None
    fleet: Callable[[], Fleet] | None = None  # its boards are shown beside the one
    record: Path | None = None  # is shown instead of a manager


class PageServer:
    """Serves until it is cancelled."""

    def __init__(self, options: Options) -> None:
        self._options = options
        if options.record is not None:
            from cm.web.recorded import RecordCommands, RecordedFrames, RecordHub  # mcap is needed only for a record

            self._hub: Hub = (record := RecordHub(options.record))
            self._watching: Watching = RecordedFrames(record)
            self._commands: Commands = RecordCommands(record)
        else:
            self._hub = Hub(options.connect, options.control)
            self._watching = Watching(self._hub)
            self._commands = Commands(self._hub, options.control)
        self._open: dict[web.WebSocketResponse, object] = {}  # pages, with their connections
        self._strangers = Strangers()

    async def serve(self, say: Callable[[str], None]) -> None:
        """`say` is given the page's address, with the token, then what there is to say of the fleet.

        Raises InvalidRequest.
        """
        fleet = None
        log = OneLine(logging.getLogger("cm.web"))
        runner = web.AppRunner(self._application(), access_log=None, keepalive_timeout=_IDLE, logger=log)
        await runner.setup()
        try:
            await self._listen(runner)
            host, port = runner.addresses[0][:2]
            scheme = "https" if self._options.tls else "http"
            if host in ("0.0.0.0", "::"):  # all interfaces: browsers need a name
                host = os.uname().nodename
            where = f"[{host}]" if ":" in host else host
            say(f"{scheme}://{where}:{port}/#token={self._options.gate.token}")
            if self._options.fleet is not None:
                from cm.web.fleet import FleetWatch  # zenoh is needed only for a fleet

                fleet = asyncio.create_task(FleetWatch(self._options.fleet, self._hub.topics, say).run())
            while True:
                await asyncio.sleep(_LOOK)
                assert runner.server is not None
                self._strangers.send_off(runner.server.connections, self._open.values())
        finally:
            if fleet is not None:
                await _ended(fleet)
            await runner.cleanup()

    async def _listen(self, runner: web.AppRunner) -> None:
        o = self._options
        try:
            await web.TCPSite(runner, o.host, o.port, ssl_context=o.tls).start()
        except OSError as error:
            why = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror or error
            raise InvalidRequest(f"cannot listen on {o.host}:{o.port}: {why}") from error

    def _application(self) -> web.Application:
        app = web.Application(middlewares=[self._guard], client_max_size=_MESSAGE)
        app.router.add_get("/ws", self._socket)
        app.router.add_get("/{file:[a-z.]*}", self._file)
        app.cleanup_ctx.append(self._follow)
        app.on_shutdown.append(self._hang_up)
        return app

    async def _follow(self, _: web.Application) -> AsyncIterator[None]:
        task = asyncio.create_task(self._hub.run())
        yield
        await self._watching.close()
        await _ended(task)

    async def _hang_up(self, _: web.Application) -> None:
        for socket in tuple(self._open):
            await socket.close(code=1001, message=b"the server ends")

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        self._strangers.heard(request.protocol)
        refused = self._options.gate.refuses_host(request.headers.get("Host", ""))
        if refused:
            return web.Response(status=421, text=f"{refused}\n", headers=_HEADERS)
        try:
            response = await handler(request)
        except web.HTTPException as error:
            return web.Response(status=error.status, text=f"{error.reason}\n", headers=_HEADERS)
        if not response.prepared:
            response.headers.update(_HEADERS)
        return response

    async def _file(self, request: web.Request) -> web.StreamResponse:
        path = STATIC / (request.match_info["file"] or "index.html")
        if path.suffix not in _TYPES or not path.is_file():
            raise web.HTTPNotFound
        return web.Response(body=path.read_bytes(), content_type=_TYPES[path.suffix], charset="utf-8")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        refused = self._options.gate.refuses_origin(request.headers.get("Origin"), request.headers.get("Host", ""))
        if refused:
            return web.Response(status=403, text=f"{refused}\n")
        socket = web.WebSocketResponse(heartbeat=20.0, max_msg_size=_MESSAGE, compress=False)
        try:
            await socket.prepare(request)
        except ConnectionError:  # its user has gone, or it was one of too many: nobody reads an answer
            return web.Response()
        near = request.remote is not None and is_loopback(request.remote)
        session = Session(socket, self._hub, self._watching, self._commands, near)
        if not await session.is_known(self._options.gate):
            return socket
        if len(self._open) >= _PAGES:
            await socket.close(code=1013, message=f"{_PAGES} pages are open already".encode())
            return socket
        self._open[socket] = request.protocol
        try:
            await session.serve()
        finally:
            del self._open[socket]
        return socket


async def _ended(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
