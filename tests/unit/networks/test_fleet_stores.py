# SPDX-License-Identifier: Apache-2.0
"""The keeper's ledger, and what is asked of etcd: against a stand-in of its gateway (the real one: make test-fleet)."""

from __future__ import annotations

import asyncio
import base64
import json
import queue
import resource
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest
from manager_process import until

from cm.errors import InvalidRequest
from cm.networks.fleet.etcd import Cluster, Etcd
from cm.networks.fleet.keeper import Keeper, Ledger, _check_names
from cm.networks.fleet.store import (
    Claim,
    Entry,
    Put,
    Settings,
    StoreAway,
    StoreRefused,
    Wanted,
    key,
    packed,
    views,
)


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def ledger() -> Iterator[Callable[..., Ledger]]:
    """Makes ledgers, which are closed at the end."""
    with ExitStack() as opened:

        def made(path: Path | str = ":memory:", clock: Callable[[], float] | None = None) -> Ledger:
            return opened.enter_context(closing(Ledger(path, lambda _: None, clock or Clock())))

        yield made


# ---- the keeper -----------------------------------------------------------------------------


def test_a_transaction_is_done_whole_or_not_at_all(ledger: Callable[..., Ledger]) -> None:
    store = ledger()
    first = store.txn({"a": 0}, {"a": Put("1"), "b": Put("2")})
    assert first
    assert store.txn({"a": 0}, {"b": Put("3")}) == 0
    assert store.txn({"a": first, "b": first}, {"a": None, "b": Put("4")}) == first + 1
    assert store.get("") == {"b": Entry("4", first + 1)}


def test_what_lies_under_a_lease_goes_with_it_by_the_keepers_own_clock(ledger: Callable[..., Ledger]) -> None:
    clock = Clock()
    store = ledger(clock=clock)
    lease = "7"
    assert set(store.claim({}, {"claim": Put("x", lease), "other": Put("y")}, lease, 5)) == {"claim", "other"}
    clock.now = 4.0
    assert store.keep(lease)
    clock.now = 8.9
    store.expire()
    assert set(store.get("")) == {"claim", "other"}
    clock.now = 9.0
    assert not store.keep(lease)
    assert set(store.get("")) == {"other"}
    with pytest.raises(StoreRefused, match="has ended"):
        store.txn({}, {"claim": Put("x", lease)})
    assert "claim" not in store.get("")


def test_a_lease_begins_anew_with_its_keeper_whatever_the_clock_says(
    ledger: Callable[..., Ledger], tmp_path: Path
) -> None:
    before = ledger(tmp_path / "s.sqlite")
    lease = "7"
    before.claim({}, {"claim": Put("x", lease)}, lease, 5)
    before.close()
    clock = Clock()
    clock.now = -86400.0  # a day back
    after = ledger(tmp_path / "s.sqlite", clock)
    assert after.keep(lease)
    clock.now += 5.0
    after.expire()
    assert after.get("") == {}


def test_a_keeper_needs_little_of_a_disk_whatever_was_decided_before(
    ledger: Callable[..., Ledger], tmp_path: Path
) -> None:
    store = ledger(tmp_path / "s.sqlite")
    for number in range(1000):  # some hundred changes
        store.txn({}, {key(f"b{number % 6}", "wanted"): Put(str(number))})
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 1 << 19


def test_a_file_that_is_no_store_is_refused(ledger: Callable[..., Ledger], tmp_path: Path) -> None:
    (tmp_path / "s.sqlite").write_bytes(b"no database" * 100)
    with pytest.raises(StoreRefused, match=r"s\.sqlite"):
        ledger(tmp_path / "s.sqlite")


def test_nobody_wants_anything_in_the_name_of_another() -> None:
    wanted = packed(Wanted(1, "camera", "edge", "anna", "c1"))
    _check_names({key("b1", "wanted"): Put(wanted)}, "anna")
    with pytest.raises(StoreRefused, match="bob cannot want something in the name of anna"):
        _check_names({key("b1", "wanted"): Put(wanted)}, "bob")


def test_what_no_version_wrote_is_named(tmp_path: Path) -> None:
    found = views({"boards/b1/settings": Entry(packed(Settings(("a",))), 3), "generation": Entry("4", 3)})
    assert found["b1"].settings == Settings(("a",))
    with pytest.raises(InvalidRequest, match="boards/b1/wanted"):
        views({"boards/b1/wanted": Entry("{}", 1)})


class Queried:
    """A zenoh session with a keeper in it, and nobody else."""

    def __init__(self) -> None:
        self.take: Callable[[Any], None] = lambda _: None

    def declare_queryable(self, _: str, handler: Any, complete: bool) -> Any:
        self.take = handler.callback
        return MagicMock()

    def liveliness(self) -> Any:
        tokens = MagicMock()
        tokens.get.return_value = []
        return tokens

    def put(self, *_: Any) -> None: ...

    def ask(self, operation: str, **what: Any) -> Any:
        """As a coordinator that waits; raises what came instead of an answer."""
        query, answered = MagicMock(), queue.SimpleQueue[bytes]()
        query.key_expr, query.payload = f"cm-store/{operation}/anna", json.dumps(what).encode()
        query.reply = lambda _, answer, encoding: answered.put(answer)
        self.take(query)
        return json.loads(answered.get(timeout=30.0))


@contextmanager
def full_disk() -> Iterator[None]:
    """No file of this process may become longer than it was."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_lease_that_ends_while_the_keepers_disk_is_full_ends_when_there_is_room(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    session = Queried()
    keeper = Keeper(session, tmp_path / "store.sqlite")
    try:
        claim = packed(Claim(1, "c", "anna"))
        asked = {"expect": {"a": 0}, "puts": {"boards/b1/claim": [claim, "7"]}, "lease": "7", "seconds": 0.3}
        assert set(session.ask("claim", **asked)["ok"]) == {"boards/b1/claim"}
        with full_disk():
            until(lambda: "it is tried again" in caplog.text, 30.0)
            assert session.ask("claim", **asked)["code"] == "store_refused"
            assert set(session.ask("get", prefix="")["ok"]) == {"boards/b1/claim"}
        until(lambda: session.ask("get", prefix="")["ok"] == {}, 30.0)
    finally:
        keeper.close()
    assert keeper.ended.result() is None


def test_a_keeper_that_fails_in_a_way_that_nobody_foresaw_ends_what_runs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: Ledger) -> None:
        raise MemoryError("no page is left")

    keeper = Keeper(Queried(), tmp_path / "store.sqlite")
    monkeypatch.setattr(Ledger, "expire", fails)
    with pytest.raises(MemoryError):
        keeper.ended.result(30.0)
    keeper.close()


# ---- etcd -----------------------------------------------------------------------------------


class Gateway:
    """What a member of etcd says: each answer is made by a function of path, body and headers."""

    def __init__(self, answer: Callable[[str, dict[str, Any], Any], tuple[int, dict[str, Any]]]) -> None:
        gateway = self
        self.asked: list[tuple[str, dict[str, Any]]] = []

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                gateway.asked.append((self.path, body))
                status, found = answer(self.path, body, self.headers)
                data = json.dumps(found).encode() + b"\n"
                self.send_response(status)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, *_: Any) -> None: ...

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"


@contextmanager
def gateway(answer: Callable[[str, dict[str, Any], Any], tuple[int, dict[str, Any]]]) -> Iterator[Gateway]:
    made = Gateway(answer)
    thread = threading.Thread(target=made.server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield made
    finally:
        made.server.shutdown()
        thread.join()
        made.server.server_close()


def done(cluster: Cluster, *work: Callable[[Etcd], Awaitable[Any]]) -> list[Any]:
    """What a client is told, one request after the other."""

    async def all_of_it() -> list[Any]:
        store = Etcd(cluster)
        try:
            return [await each(store) for each in work]
        finally:
            await store.close()

    return asyncio.run(all_of_it())


def b64(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


def test_a_transaction_compares_revisions_and_begins_its_keys_with_our_prefix() -> None:
    with gateway(lambda *_: (200, {"header": {"revision": "7"}, "succeeded": True})) as member:
        found = done(Cluster((member.url,)), lambda store: store.txn({"a": 0, "b": 5}, {"a": Put("x", "9"), "b": None}))
        assert found == [7]
        ((path, body),) = member.asked
    assert path == "/v3/kv/txn"
    assert [(c["key"], c["mod_revision"]) for c in body["compare"]] == [(b64("cm/a"), "0"), (b64("cm/b"), "5")]
    assert body["success"][0]["request_put"] == {"key": b64("cm/a"), "value": b64("x"), "lease": "9"}
    assert body["success"][1] == {"request_delete_range": {"key": b64("cm/b")}}


def test_a_member_without_a_leader_is_passed_over_and_a_refusal_is_not() -> None:
    with (
        gateway(lambda *_: (503, {"error": "etcdserver: no leader", "code": 14})) as first,
        gateway(lambda *_: (200, {"header": {}, "kvs": [{"key": b64("cm/a"), "mod_revision": "3"}]})) as second,
    ):
        found = done(Cluster((first.url, second.url)), *[lambda store: store.get("")] * 2)
        assert found == [{"a": Entry("", 3)}] * 2
        assert len(first.asked) == 1  # from then on the one that answered is asked first
    with gateway(lambda *_: (400, {"error": "etcdserver: too many operations in txn request", "code": 3})) as member:
        with pytest.raises(StoreRefused, match="--max-txn-ops"):
            done(Cluster((member.url,)), lambda store: store.txn({}, {"a": Put("x")}))
        assert len(member.asked) == 1


def test_a_first_read_does_not_wait_for_a_member_that_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cm.networks.fleet.etcd._ONE", 600.0)
    going_on = threading.Event()

    def hang(*_: Any) -> tuple[int, dict[str, Any]]:
        going_on.wait()
        return 200, {"header": {}}

    with (
        gateway(hang) as first,
        gateway(lambda *_: (200, {"header": {}, "kvs": [{"key": b64("cm/a"), "mod_revision": "3"}]})) as second,
    ):
        try:
            found = done(
                Cluster((first.url, second.url)),
                lambda store: asyncio.wait_for(store.get(""), 60.0),
                lambda store: asyncio.wait_for(store.txn({}, {}), 60.0),
            )
        finally:
            going_on.set()
        assert found == [{"a": Entry("", 3)}, 0]
        assert len(first.asked) == 1


def test_an_answer_in_chunks_is_read_whole_and_a_connection_that_was_closed_is_made_anew() -> None:
    data = json.dumps({"header": {}, "kvs": [{"key": b64("cm/a"), "mod_revision": "3"}]}).encode()

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readuntil(b"\r\n\r\n")
        await reader.readexactly(int(head.split(b"Content-Length: ")[1].split()[0]))
        writer.write(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n")
        for piece in (data[:10], data[10:], b""):
            writer.write(b"%x\r\n%s\r\n" % (len(piece), piece))
        writer.close()

    async def run() -> None:
        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        store = Etcd(Cluster((f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}",)))
        for _ in range(3):
            assert await store.get("") == {"a": Entry("", 3)}
        await store.close()
        server.close()

    asyncio.run(run())


def test_a_users_token_is_fetched_and_fetched_again_when_it_has_ended(tmp_path: Path) -> None:
    tokens = iter(("old", "new"))

    def answer(path: str, body: dict[str, Any], headers: Any) -> tuple[int, dict[str, Any]]:
        if path == "/v3/auth/authenticate":
            assert body == {"name": "anna", "password": "secret"}
            return 200, {"token": next(tokens)}
        if headers["Authorization"] != "new":
            return 401, {"error": "etcdserver: invalid auth token", "code": 16}
        return 200, {"header": {}}

    (tmp_path / "password").write_text("secret\n")
    with gateway(answer) as member:
        cluster = {"members": [member.url], "user": "anna", "password_file": str(tmp_path / "password")}
        (tmp_path / "store.json").write_text(json.dumps(cluster))
        assert done(Cluster.read(str(tmp_path / "store.json")), lambda store: store.get("")) == [{}]


@pytest.mark.parametrize("reason", ["etcdserver: permission denied", "rpc error: code = Unauthenticated", None])
def test_a_watch_that_etcd_refuses_is_asked_for_again_after_a_pause_with_a_new_token_and_said_once(
    reason: str | None, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """etcd says so with 200: 3.4 and 3.5 cancel the watch in the message that says that it was created."""
    logins, pauses = [], []
    refused = {"header": {"revision": "5"}, "created": True, "canceled": True, "watch_id": "-1"}

    def answer(path: str, _: dict[str, Any], headers: Any) -> tuple[int, dict[str, Any]]:
        if path == "/v3/auth/authenticate":
            logins.append(path)
            return 200, {"token": f"t{len(logins)}"}
        if len(logins) < 6:
            return 200, {"result": {**refused, **({"cancel_reason": reason} if reason else {})}}
        return 200, {"result": {"header": {"revision": "7"}, "created": True}}

    async def told_of(store: Etcd) -> list[dict[str, Entry]]:
        found = []
        async for changes in store.watch("boards/b1/"):
            found.append(changes)
            if len(found) == 6:
                break
        return found

    rests = asyncio.sleep

    async def rest(seconds: float) -> None:
        pauses.append(seconds)
        await rests(0)

    (tmp_path / "password").write_text("secret")
    with gateway(answer) as member:
        cluster = Cluster((member.url,), user="anna", password_file=str(tmp_path / "password"))
        monkeypatch.setattr("asyncio.sleep", rest)
        assert done(cluster, told_of) == [[{}] * 6]  # of each gap: it is read, and whoever may not is told why
    assert [pause for pause in pauses if pause] == [1.0, 2.0, 4.0, 8.0, 8.0]
    assert len(logins) == 6
    assert [record.message for record in caplog.records] == [
        f"etcd does not tell what changes under cm/boards/b1/: {reason or 'it gives no reason'}"
    ]


def test_a_watch_that_was_compacted_away_is_read_anew_at_once() -> None:
    answers = iter([{"created": True}, {"canceled": True, "compact_revision": "6"}, {"created": True}])

    def answer(*_: Any) -> tuple[int, dict[str, Any]]:
        return 200, {"result": {"header": {"revision": "7"}, **next(answers)}}

    async def told_of(store: Etcd) -> list[dict[str, Entry]]:
        watch = store.watch("").__aiter__()
        return [await anext(watch) for _ in range(3)]

    with gateway(answer) as member:
        assert done(Cluster((member.url,)), told_of) == [[{}, {}, {}]]
        assert [body["create_request"].get("start_revision") for _, body in member.asked] == [None, "8", None]


def test_a_lease_that_has_ended_is_no_error() -> None:
    with gateway(lambda *_: (404, {"error": "etcdserver: requested lease not found", "code": 5})) as member:
        done(Cluster((member.url,)), lambda store: store.revoke("5"))
    with gateway(lambda *_: (200, {"result": {"ID": "5"}})) as member:
        assert done(Cluster((member.url,)), lambda store: store.keep("5")) == [False]


def test_when_no_member_answers_it_is_said_which_were_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cm.networks.fleet.etcd._ALL", 0.0)
    with pytest.raises(StoreAway, match=r"etcd does not answer at http://127\.0\.0\.1:9"):
        done(Cluster(("http://127.0.0.1:9",)), lambda store: store.get(""))


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("ftp://host", "https://HOST:2379 is wanted"),
        ("http://user:word@host:2379", "stand in a file"),
        ("/nowhere/store.json", "'keeper', etcd's URLs"),
        ("s.json", "members at least"),
    ],
)
def test_a_store_that_cannot_be_meant_is_refused_with_what_is_wanted(
    said: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.json").write_text('{"user": "anna"}')
    with pytest.raises(InvalidRequest, match=why):
        Cluster.read(said)
