# SPDX-License-Identifier: Apache-2.0
"""What is counted for metrics, and a server of them that no scraper can hold up."""

from __future__ import annotations

import errno
import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import SimpleNamespace
from typing import Any

import pytest
from manager_process import until

from cm.device.data_plane import StreamSetup
from cm.errors import InvalidRequest
from cm.manager.status_reports import ChangeTotals, Histogram
from cm.server.metrics_server import CONNECTIONS, MetricsServer, split_address
from cm.server.streams import stream
from cm.server.streams.stream import Moved, StreamTotals
from cm.wire.messages.status import ErrorInfo

WAIT = 30.0


# ---- what is counted ----------------------------------------------------------------------


def test_a_histogram_adds_up_from_bucket_to_bucket() -> None:
    made = Histogram((0.1, 1.0))
    for value in (0.05, 0.1, 0.5, 3.0):
        made.add(value)
    assert made.read() == ((0.1, 1.0), (2, 3, 4), pytest.approx(3.65))


def test_steps_and_loads_of_changes_are_added_up() -> None:
    totals = ChangeTotals()
    for code in (None, None, "cancelled", "load_failed"):
        totals.ended(code, 0.25)
    totals.took("load", 0.5)
    totals.took("load", 0.25)
    totals.loaded("icap", 1000, 0.125)
    counts = totals.read()
    assert counts.outcomes == {"done": 2, "cancelled": 1, "failed": 1}
    assert counts.failures == {"cancelled": 1, "load_failed": 1}
    assert counts.loads["icap"] == (1, 1000, 0.125)
    assert counts.steps == {"load": (2, 0.75)}


def test_what_a_stream_moved_before_it_was_closed_still_counts() -> None:
    totals = StreamTotals()
    totals.add("camera", Moved(10, 1, 0, 1000))
    totals.add("camera", Moved(5, 0, 2, 500))
    assert totals.with_ended({"camera": Moved(1, 0, 0, 100), "other": Moved(frames=7)}) == {
        "camera": Moved(16, 1, 2, 1600),
        "other": Moved(frames=7),
    }
    assert totals.with_ended({})["camera"].frames == 15


@pytest.mark.parametrize(
    ("ages", "frames"),
    [
        ([], 0.0), ([0.5], 1.0), ([1.0], 0.0), ([2.0], 0.0), ([1.1, 0.3, 0.2, 0.1], 10.0), ([0.9, 0.4], 2.0),
        ([0.4, 0.4], 2.0),
    ],
)  # fmt: skip
def test_a_rate_is_that_of_the_last_second(monkeypatch: pytest.MonkeyPatch, ages: list[float], frames: float) -> None:
    monkeypatch.setattr(stream, "time", SimpleNamespace(monotonic_ns=lambda: 10**12))
    counts: Any = SimpleNamespace(at_ns=[10**12 - round(age * 1e9) for age in ages])
    assert stream.rate(counts) == pytest.approx(frames)


def test_a_median_is_in_the_middle_and_a_failed_transfer_is_told() -> None:
    assert [stream.median(values) for values in ([], [3], [9, 1, 5], [4, 1, 2, 3])] == [0, 3, 5, 3]
    more = "; the packet was longer than the frame, or the bus reported an error"
    for error, write, said in (
        (errno.EIO, False, f"Input/output error{more}"), (errno.EIO, True, "Input/output error"),
        (errno.ETIMEDOUT, False, "Connection timed out"), (0, False, None),
    ):  # fmt: skip
        told = stream.transfer_error(SimpleNamespace(error=error), StreamSetup(write, 4096))  # type: ignore[arg-type]
        assert told == (said and ErrorInfo("transfer_failed", f"a transfer of 4096 bytes failed: {said}"))


# ---- the server -------------------------------------------------------------------------


class Served:
    """A metrics server."""

    def __init__(self, page: bytes, port: int) -> None:
        self.pages = 0
        self.go_on = threading.Event()
        self.go_on.set()
        self._page = page
        self.server = MetricsServer(self._made)
        where = self.server.open(str(port))
        self.port = int(where.rpartition(":")[2])

    def _made(self) -> bytes:
        self.pages += 1
        assert self.go_on.wait(WAIT)
        return self._page

    def get(self, path: str = "/metrics", method: str = "GET") -> tuple[int, bytes]:
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", method=method)
        try:
            with urllib.request.urlopen(request, timeout=WAIT) as reply:
                return reply.status, reply.read()
        except urllib.error.HTTPError as error:
            with error:
                return error.code, error.read()

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), WAIT)


@contextmanager
def serving(page: bytes = b"x 1\n", port: int = 0) -> Iterator[Served]:
    served = Served(page, port)
    try:
        yield served
    finally:
        served.server.close()


@pytest.fixture
def served() -> Iterator[Served]:
    with serving() as made:
        yield made


def test_the_page_is_at_its_place_and_nothing_elsewhere(served: Served) -> None:
    assert served.get() == (200, b"x 1\n")
    assert served.get("/metrics?x=1")[0] == 200
    assert served.get("/etc/passwd")[0] == 404
    assert served.get(method="POST")[0] == 501
    assert served.get(method="HEAD") == (200, b"")
    assert b"the metrics are at /metrics" in served.get("/metrics/")[1]
    with served.connect() as sock:
        sock.sendall(b"GET / HTTP/1.0\r\n\r\n")
        head, _, body = sock.makefile("rb").read().partition(b"\r\n\r\n")
    assert {b"Content-Type: text/plain; version=0.0.4; charset=utf-8", b"Content-Length: 4"} <= set(head.split(b"\r\n"))
    assert body == b"x 1\n"
    assert served.server.scrapes == 4  # no page was made elsewhere


def test_a_page_that_cannot_be_made_is_logged_and_the_next_is_served(
    served: Served, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(served.server, "_page", lambda: 1 // 0)
        with served.connect() as sock:
            sock.sendall(b"GET / HTTP/1.0\r\n\r\n")
            assert sock.makefile("rb").read() == b""
    until(lambda: caplog.messages)
    assert caplog.messages == ["metrics: a page could not be made"]
    assert served.get() == (200, b"x 1\n")


def test_a_request_may_come_in_pieces(served: Served) -> None:
    with served.connect() as sock:
        for piece in (b"GET /metr", b"ics HTTP/1.1\r\nHost: x\r", b"\n\r\n"):
            sock.sendall(piece)
        assert b"x 1\n" in sock.makefile("rb").read()


def test_a_request_without_an_end_is_refused(served: Served) -> None:
    with served.connect() as sock:
        sock.sendall(b"GET /" + b"a" * (1 << 16))
        assert b" 414 " in sock.makefile("rb").readline()


def test_a_client_that_asks_for_much_and_reads_nothing_holds_no_others_up() -> None:
    with serving(b"x" * (8 << 20)) as served, ExitStack() as stack:
        for _ in range(CONNECTIONS // 2):
            stack.enter_context(served.connect()).sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
        assert len(served.get()[1]) == 8 << 20


def test_beyond_the_limit_the_oldest_connection_is_closed(served: Served) -> None:
    with ExitStack() as stack:
        idle = [stack.enter_context(served.connect()) for _ in range(CONNECTIONS * 3)]
        assert served.get() == (200, b"x 1\n")
        assert idle[0].recv(1) == b""


def test_simultaneous_requests_share_one_page(served: Served) -> None:
    served.go_on.clear()
    with ExitStack() as stack:
        asked = [stack.enter_context(served.connect()) for _ in range(CONNECTIONS)]
        for sock in asked:
            sock.sendall(b"GET / HTTP/1.0\r\n\r\n")
        until(lambda: served.pages)
        served.go_on.set()  # the next page is made twenty times as long after this one as it took
        for sock in asked:
            assert sock.makefile("rb").read().endswith(b"x 1\n")
    assert served.pages <= CONNECTIONS // 2


@pytest.mark.parametrize("reply", ["half", "none"])
def test_a_client_that_hangs_up_before_the_reply_is_forgotten(served: Served, reply: str) -> None:
    for _ in range(CONNECTIONS * 2):
        with served.connect() as sock:
            sock.sendall(b"GET / HTTP/1.0\r\n\r\n" if reply == "none" else b"GET / HT")
    assert served.get() == (200, b"x 1\n")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("9469", ("127.0.0.1", 9469)),
        ("65535", ("127.0.0.1", 65535)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),
        ("[::1]:1", ("::1", 1)),
        ("board.local:9469", ("board.local", 9469)),
    ],
)
def test_a_port_alone_means_this_machine(text: str, where: tuple[str, int]) -> None:
    assert split_address(text) == where


@pytest.mark.parametrize("text", ["", "here", ":80", "localhost:", "1.2.3.4:65536", "x:-1", "x:٣"])
def test_what_is_not_an_address_is_reported(text: str) -> None:
    with pytest.raises(InvalidRequest, match="PORT on this machine"):
        split_address(text)


def test_a_port_that_is_taken_is_reported() -> None:
    with serving() as served, pytest.raises(InvalidRequest, match=r"cannot listen on .*: Address already in use"):
        MetricsServer(bytes).open(str(served.port))


def test_once_it_is_closed_nobody_waits_for_a_page_and_the_port_is_free(served: Served) -> None:
    with served.connect() as sock:
        sock.sendall(b"GET /metr")
        served.server.close()
        with suppress(ConnectionResetError):  # where it was not accepted yet
            assert sock.recv(1) == b""
    with serving(port=served.port) as again:
        assert again.get() == (200, b"x 1\n")
