# SPDX-License-Identifier: Apache-2.0
"""A server of one page, in the daemon's own loop, which no scraper can hold up.

Each connection carries one request, which has to be short and to arrive soon, and one reply. There are never more
than `CONNECTIONS` of them: the oldest is closed when another comes. All that have asked by then get the same page.
After a page the server rests for `_REST` times as long as making it took, and accepts no new connection meanwhile, so
that a client that asks as often as it can takes only a small share of the loop's time.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from cm.errors import InvalidRequest
from cm.loop import Loop, Timer
from cm.metrics.text import CONTENT_TYPE

CONNECTIONS = 16
_SECONDS = 5.0  # for a request to come whole, and for its reply to be read
_LONGEST = 4096  # bytes of a request
_REST = 20.0
_SHORTEST_REST = 0.02  # seconds; also after as many connections as there may be at once
_PATHS = (b"/metrics", b"/")


def split_address(text: str) -> tuple[str, int]:
    """``HOST:PORT``, or ``PORT`` on this machine only. Raises InvalidRequest."""
    host, colon, port = text.rpartition(":")
    if not port.isascii() or not port.isdecimal() or int(port) > 65535 or (colon and not host):
        raise InvalidRequest(f"{text!r} is not an address for metrics: PORT on this machine, or HOST:PORT")
    return (host or "127.0.0.1").strip("[]"), int(port)


class MetricsServer:
    """Listens from `open` on; `page` makes the text. The loop's thread."""

    def __init__(self, loop: Loop, page: Callable[[], bytes]) -> None:
        self._loop = loop
        self._page = page
        self._listener: socket.socket | None = None
        self._connections: dict[int, _Connection] = {}
        self._asked: list[_Connection] = []
        self._accepted = 0  # since the last rest
        self._rests = False
        self._until = 0.0
        self.scrapes = 0

    def open(self, address: str) -> str:
        """Listen; returns where, with the port that was taken for port 0. Raises InvalidRequest."""
        host, port = split_address(address)
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self._listener = socket.create_server((host, port), family=family, backlog=4 * CONNECTIONS)
        except OSError as error:
            raise InvalidRequest(f"metrics: cannot listen on {address}: {_reason(error)}") from error
        self._listener.setblocking(False)
        self._loop.add(self._listener.fileno(), self._accept, listener=True)
        bound = self._listener.getsockname()
        return f"{f'[{bound[0]}]' if family == socket.AF_INET6 else bound[0]}:{bound[1]}"

    def close(self) -> None:
        """Hang up on all."""
        for connection in list(self._connections.values()):
            connection.close()
        if self._listener is not None:
            self._loop.remove(self._listener.fileno())
            self._listener.close()
            self._listener = None

    def _accept(self) -> None:
        """Accept all waiting connections, so that one page is made for many."""
        for _ in range(CONNECTIONS):
            assert self._listener is not None
            try:
                sock, _ = self._listener.accept()
            except BlockingIOError:
                return
            except OSError:  # no descriptors are left: the connections keep waiting
                break
            self._let_in(sock)
        self._rest(_SHORTEST_REST)

    def _let_in(self, sock: socket.socket) -> None:
        if len(self._connections) >= CONNECTIONS:
            next(iter(self._connections.values())).close()
        sock.setblocking(False)
        connection = _Connection(self._loop, sock, self._answer, self._gone)
        self._connections[connection.fd] = connection
        self._accepted += 1
        if self._accepted >= CONNECTIONS:  # since the last rest, by ones and twos
            self._rest(_SHORTEST_REST)

    def _gone(self, connection: _Connection) -> None:
        self._connections.pop(connection.fd, None)
        if connection in self._asked:
            self._asked.remove(connection)

    def _answer(self, connection: _Connection) -> None:
        """A connection has asked for the page."""
        self._asked.append(connection)
        if not self._rests:
            self._loop.call_soon(self._tell)
            self._rest(_SHORTEST_REST)

    def _tell(self) -> None:
        """Make the page, and send it to all that have asked by now."""
        asked, self._asked = self._asked, []
        if not asked:
            return
        began = time.monotonic()
        self.scrapes += len(asked)
        text = self._page()
        for connection in asked:
            connection.reply(200, "OK", text)
        self._rest(max(_SHORTEST_REST, _REST * (time.monotonic() - began)))

    def _rest(self, seconds: float) -> None:
        if self._listener is None:
            return
        if not self._rests:
            self._loop.pause(self._listener.fileno())
        self._rests, self._accepted = True, 0
        self._until = time.monotonic() + seconds
        self._loop.call_later(seconds, self._rested)

    def _rested(self) -> None:
        if self._listener is None or time.monotonic() < self._until:
            return
        self._rests = False
        self._loop.resume(self._listener.fileno())
        self._tell()


class _Connection:
    """One request and its reply."""

    def __init__(
        self,
        loop: Loop,
        sock: socket.socket,
        asked: Callable[[_Connection], None],
        gone: Callable[[_Connection], None],
    ) -> None:
        self._loop, self._socket, self._asked, self._gone = loop, sock, asked, gone
        self.fd = sock.fileno()
        self._request = b""
        self._left: memoryview | None = None
        self._head_only = False
        self._limit: Timer = loop.call_later(_SECONDS, self.close)
        loop.add(self.fd, self._readable)

    def _readable(self) -> None:
        try:
            piece = self._socket.recv(_LONGEST)
        except BlockingIOError:
            return
        except OSError:
            piece = b""
        if not piece:
            self.close()
            return
        self._request += piece
        if b"\r\n\r\n" in self._request or b"\n\n" in self._request:
            self._loop.pause(self.fd)
            self._take()
        elif len(self._request) >= _LONGEST:
            self.reply(431, "Request Header Fields Too Large", b"the request is too long\n")

    def _take(self) -> None:
        method, path = [*self._request.split(b"\n", 1)[0].split(), b"", b""][:2]
        self._head_only = method == b"HEAD"
        if method not in (b"GET", b"HEAD"):
            self.reply(405, "Method Not Allowed", b"GET /metrics\n")
        elif path.partition(b"?")[0] not in _PATHS:
            self.reply(404, "Not Found", b"the metrics are at /metrics\n")
        else:
            self._asked(self)

    def reply(self, status: int, reason: str, body: bytes) -> None:
        """Send the reply as fast as the other side reads it, and hang up."""
        head = "".join(_head(status, reason, len(body))).encode()
        self._left = memoryview(head if self._head_only else head + body)
        self._loop.watch_write(self.fd, self._writable)

    def _writable(self) -> None:
        assert self._left is not None
        try:
            self._left = self._left[self._socket.send(self._left) :]
        except BlockingIOError:
            return
        except OSError:
            self.close()
            return
        if not self._left:
            self.close()

    def close(self) -> None:
        """Hang up; twice is fine."""
        if self._socket.fileno() < 0:
            return
        self._limit.cancel()
        self._loop.remove(self.fd)
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        self._socket.close()
        self._gone(self)


def _reason(error: OSError) -> str:
    """Without what `socket.create_server` adds: our message names the address already."""
    return (error.strerror or str(error)).partition(" (while")[0]


def _head(status: int, reason: str, length: int) -> Iterator[str]:
    yield f"HTTP/1.1 {status} {reason}\r\n"
    yield f"Content-Type: {CONTENT_TYPE}\r\n"
    yield f"Content-Length: {length}\r\n"
    if status == 405:
        yield "Allow: GET, HEAD\r\n"
    yield "X-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n"
