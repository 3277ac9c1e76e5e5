# SPDX-License-Identifier: Apache-2.0
"""A server of one page, in threads of its own, which no scraper can hold up.

There are never more than `CONNECTIONS`, each of one short request that has to arrive soon: the oldest is hung up on
when another comes. All that have asked by then get the same page, and the next is made after `_REST` times as long as
making it took, so that whoever asks as often as it can gets only a small share of the manager's time.
"""

from __future__ import annotations

import itertools
import logging
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler
from socketserver import TCPServer, ThreadingMixIn
from typing import Any

from cm.errors import InvalidRequest

_LOG = logging.getLogger("cm")
CONNECTIONS = 16
_CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_SECONDS = 5.0  # for each piece of a request, and of its reply
_REST = 20.0
_SHORTEST_REST = 0.02  # seconds; also after as many connections as there may be at once
_PATHS = ("/metrics", "/")


def split_address(text: str) -> tuple[str, int]:
    """``HOST:PORT``, or ``PORT`` on this machine only. Raises InvalidRequest."""
    host, colon, port = text.rpartition(":")
    if not port.isascii() or not port.isdecimal() or int(port) > 65535 or (colon and not host):
        raise InvalidRequest(f"{text!r} is not an address for metrics: PORT on this machine, or HOST:PORT")
    return (host or "127.0.0.1").strip("[]"), int(port)


class MetricsServer:
    """Listens from `open` on; `page` makes the text, in threads of the server, one at a time."""

    def __init__(self, page: Callable[[], bytes]) -> None:
        self._page = page
        self._text = b""
        self._made, self._rests_until = 0.0, 0.0
        self._making = threading.Lock()
        self._listener: _Listener | None = None
        self.scrapes = 0

    def open(self, address: str) -> str:
        """Listen; returns where, with the port that was taken for port 0. Raises InvalidRequest."""
        host, port = split_address(address)
        try:
            self._listener = _Listener(host, port, self.text)
        except OSError as error:
            raise InvalidRequest(f"metrics: cannot listen on {address}: {error.strerror or error}") from error
        bound = self._listener.socket.getsockname()
        return f"[{bound[0]}]:{bound[1]}" if ":" in host else f"{bound[0]}:{bound[1]}"

    def close(self) -> None:
        """Hang up on all; twice is fine."""
        if self._listener is not None:
            self._listener.end()
            self._listener = None

    def text(self) -> bytes:
        """A page that was begun after this call; several calls may share it."""
        asked = time.monotonic()
        with self._making:
            self.scrapes += 1
            if self._made < asked:
                time.sleep(max(0.0, self._rests_until - time.monotonic()))
                self._made = time.monotonic()
                self._text = self._page()
                self._rests_until = time.monotonic() + max(_SHORTEST_REST, _REST * (time.monotonic() - self._made))
            return self._text


class _Listener(ThreadingMixIn, TCPServer):
    """A thread that accepts, and one for each connection. (HTTPServer would look up the name of our address.)"""

    allow_reuse_address = True
    daemon_threads = True
    request_queue_size = 4 * CONNECTIONS

    def __init__(self, host: str, port: int, page: Callable[[], bytes]) -> None:
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), _Handler)
        self.page = page
        self._open: dict[socket.socket, None] = {}  # oldest first
        self._opening = threading.Lock()
        self._accepted = itertools.count(1)
        self._ending = False
        self._thread = threading.Thread(target=self._accept, name="cm-metrics", daemon=True)
        self._thread.start()

    def _accept(self) -> None:
        while not self._ending:
            self.handle_request()

    def end(self) -> None:
        """Accept no more, and hang up on all."""
        self._ending = True
        self.socket.shutdown(socket.SHUT_RDWR)  # wakes the thread
        self._thread.join()
        self.server_close()
        with self._opening:
            for connection in self._open:
                _hang_up(connection)

    def get_request(self) -> tuple[Any, Any]:
        """Accept; if no descriptors are left, the connection keeps waiting."""
        try:
            return super().get_request()
        except OSError:
            time.sleep(_SHORTEST_REST)
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        """Let a connection in, in place of the oldest if there are as many as there may be."""
        if next(self._accepted) % CONNECTIONS == 0:
            time.sleep(_SHORTEST_REST)
        with self._opening:
            if len(self._open) >= CONNECTIONS:
                oldest = next(iter(self._open))
                del self._open[oldest]
                _hang_up(oldest)
            self._open[request] = None
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """A connection has had its reply, or has failed."""
        with self._opening:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        """A scraper that has gone, or took too long, is nobody's concern."""
        if not isinstance(sys.exc_info()[1], OSError):
            _LOG.exception("metrics: a page could not be made")


class _Handler(BaseHTTPRequestHandler):
    server: _Listener
    timeout = _SECONDS

    def do_GET(self) -> None:
        """The page."""
        if self.path.partition("?")[0] not in _PATHS:
            self.send_error(404, explain="the metrics are at /metrics")
            return
        text = self.server.page()
        self.send_response(200)
        self.send_header("Content-Type", _CONTENT_TYPE)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)

    do_HEAD = do_GET  # noqa: N815 (named by the base class)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Scrapes are counted, not logged."""


def _hang_up(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)
