# SPDX-License-Identifier: Apache-2.0
"""A store on etcd (3.4 and later), over its JSON gateway: one connection at a time for requests, one for each watch.

The gateway: https://etcd.io/docs/v3.4/dev-guide/api_grpc_gateway/. Its keys and values are base64, its numbers text.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import http.client
import json
import socket
import ssl
import threading
import time
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from cm.errors import InvalidRequest
from cm.networks.fleet.network import in_loop
from cm.networks.fleet.store import BOARDS, Entry, Put, StoreAway, StoreRefused, key

PREFIX = "cm/"  # of all our keys: others may use the same cluster
_ONE = 2.0  # seconds for one member's answer
_ALL = 8.0  # and for that of any
_MANY = 3.0  # more for an answer with all boards
_PACE = 200e3  # bytes a second of a large request, beyond that
_QUIET = 15.0  # seconds without a word after which a watch asks another member
_ANOTHER_MEMBER = (4, 14)  # gRPC's DEADLINE_EXCEEDED, UNAVAILABLE: another member may do it
_UNAUTHENTICATED = 16
_NOT_FOUND = 5


@dataclass(frozen=True, slots=True)
class Cluster:
    """Where etcd's members are, and how they are to be spoken to; files as etcdctl's --cacert, --cert, --key."""

    members: tuple[str, ...]  # https://host:2379
    cacert: str = ""
    cert: str = ""
    key: str = ""
    user: str = ""
    password_file: str = ""

    @classmethod
    def read(cls, said: str) -> Cluster:
        """URLs between commas, or a file of JSON with these fields. Raises InvalidRequest."""
        if "://" in said:
            return cls(tuple(_url(each) for each in said.split(",")))
        try:
            plain = json.loads(Path(said).read_text(encoding="utf-8"))
            return cls(**{**plain, "members": tuple(_url(each) for each in plain["members"])})
        except OSError as error:
            raise InvalidRequest(
                f"store {said!r}: 'keeper', etcd's URLs (https://HOST:2379,…) or a file is wanted: {error.strerror}"
            ) from None
        except (ValueError, KeyError, TypeError) as error:
            fields = ", ".join(cls.__slots__)
            raise InvalidRequest(f"{said}: JSON with {fields} is wanted, members at least ({error})") from None


def _url(text: str) -> str:
    parts = urlsplit(text.strip())
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.username:
        raise InvalidRequest(
            f"store {text!r}: https://HOST:2379 is wanted; user and password_file stand in a file (docs/fleet.md)"
        )
    return f"{parts.scheme}://{parts.netloc}"


class _Failed(Exception):
    """gRPC's code and message."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class Etcd:
    """The store of `cm.networks.fleet.store`. Requests run in threads; each member is tried until one answers."""

    def __init__(self, cluster: Cluster) -> None:
        """Raises InvalidRequest for files that cannot be used; nothing is connected yet."""
        self._cluster = cluster
        self._tls = _tls(cluster)
        self._idle: list[tuple[str, http.client.HTTPConnection]] = []
        self._lock = threading.Lock()  # of what is idle: requests run in several threads
        self._first = 0  # the member that answered last
        self._token = ""
        self._over = threading.Event()
        self._streams: set[_Stream] = set()

    async def get(self, prefix: str) -> dict[str, Entry]:
        """As Store has it."""
        found = await self._ask("kv/range", _range(prefix), 0.0 if prefix.endswith("/") and prefix != BOARDS else _MANY)
        return _entries(found.get("kvs", ()))

    async def txn(self, expect: Mapping[str, int], puts: Mapping[str, Put | None]) -> int:
        """As Store has it. A repetition after a lost answer fails if the compares name a key that it puts."""
        compare = [
            {"key": _key(k), "target": "MOD", "result": "EQUAL", "mod_revision": str(revision)}
            for k, revision in expect.items()
        ]
        found = await self._ask("kv/txn", {"compare": compare, "success": [_put(k, put) for k, put in puts.items()]})
        return int(found["header"]["revision"]) if found.get("succeeded") else 0

    async def join(self, board: str, settings: str) -> None:
        """As Store has it; the role of a board's user lets it write that key only."""
        await self.txn({}, {key(board, "settings"): Put(settings)})

    async def grant(self, seconds: int) -> str:
        """As Store has it."""
        return str((await self._ask("lease/grant", {"TTL": str(seconds)}))["ID"])

    async def keep(self, lease: str) -> bool:
        """As Store has it."""
        return int((await self._ask("lease/keepalive", {"ID": lease})).get("result", {}).get("TTL", 0)) > 0

    async def revoke(self, lease: str) -> None:
        """As Store has it."""
        with contextlib.suppress(_Gone):
            await self._ask("lease/revoke", {"ID": lease})

    async def close(self) -> None:
        """As Store has it."""
        self._over.set()
        for stream in tuple(self._streams):
            stream.end()
        while self._idle:
            self._idle.pop()[1].close()

    async def watch(self, prefix: str) -> AsyncIterator[dict[str, Entry]]:
        """As Store has it."""
        stream = _Stream(self, prefix)
        self._streams.add(stream)
        try:
            while not self._over.is_set():
                yield await stream.changes.get()
        finally:
            stream.end()
            self._streams.discard(stream)

    # ---- requests -------------------------------------------------------------------------

    async def _ask(self, path: str, body: Mapping[str, Any], slow: float = 0.0) -> dict[str, Any]:
        return await asyncio.to_thread(self._asked, path, json.dumps(body).encode(), slow)

    def _asked(self, path: str, body: bytes, slow: float) -> dict[str, Any]:
        slow += len(body) / _PACE
        end, said = time.monotonic() + _ALL + 2 * slow, ""
        while True:
            for number in range(len(self._cluster.members)):
                place = (self._first + number) % len(self._cluster.members)
                try:
                    found = self._of_member(self._cluster.members[place], path, body, slow)
                except (OSError, http.client.HTTPException) as error:
                    said = str(error) or type(error).__name__
                except _Failed as error:
                    said = str(error)
                    if error.code == _UNAUTHENTICATED and self._cluster.user and path != "auth/authenticate":
                        self._token = ""
                    elif error.code not in _ANOTHER_MEMBER:
                        raise (_Gone if error.code == _NOT_FOUND else StoreRefused)(_explained(said)) from None
                else:
                    self._first = place
                    return found
                if time.monotonic() > end or self._over.is_set():
                    break
            if time.monotonic() > end or self._over.is_set():
                raise StoreAway(f"etcd does not answer at {', '.join(self._cluster.members)}: {said}")
            time.sleep(0.1)

    def _of_member(self, member: str, path: str, body: bytes, slow: float = 0.0) -> dict[str, Any]:
        headers = self._headers(member, path)
        connection = self._connection(member)
        try:
            connection.timeout = _ONE + slow
            if connection.sock is not None:
                connection.sock.settimeout(_ONE + slow)
            connection.request("POST", f"/v3/{path}", body, headers)
            answer = connection.getresponse()
            data = answer.read()
        except BaseException:
            connection.close()
            raise
        self._idle.append((member, connection))
        return _parsed(data, answer.status)

    def _headers(self, member: str, path: str) -> dict[str, str]:
        """With the user's token, which is fetched where there is none."""
        if self._cluster.user and not self._token and path != "auth/authenticate":
            words = Path(self._cluster.password_file).read_text(encoding="utf-8").strip()
            asked = json.dumps({"name": self._cluster.user, "password": words}).encode()
            self._token = self._of_member(member, "auth/authenticate", asked)["token"]
        return {"Content-Type": "application/json", **({"Authorization": self._token} if self._token else {})}

    def _connection(self, member: str) -> http.client.HTTPConnection:
        """One that is idle, or a new one: a request on one that has been closed meanwhile is repeated on another."""
        with self._lock:
            for number, (whose, connection) in enumerate(self._idle):
                if whose == member:
                    del self._idle[number]
                    return connection
        return self.connected(member, _ONE)

    def connected(self, member: str, timeout: float) -> http.client.HTTPConnection:
        """A new connection; it begins with its first request."""
        parts = urlsplit(member)
        assert parts.hostname
        if parts.scheme == "https":
            return http.client.HTTPSConnection(parts.hostname, parts.port or 2379, timeout=timeout, context=self._tls)
        return http.client.HTTPConnection(parts.hostname, parts.port or 2379, timeout=timeout)

    def opened(self, number: int, body: bytes) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        """A stream of the watch, at the member of that number. Raises what a request does."""
        member = self._cluster.members[number % len(self._cluster.members)]
        headers = self._headers(member, "watch")
        connection = self.connected(member, _QUIET)
        connection.request("POST", "/v3/watch", body, headers)
        return connection, connection.getresponse()


class _Gone(StoreRefused):
    """A lease that has ended."""


class _Stream:
    """A watch in a thread of its own: puts what it is told into `changes`, in the loop."""

    def __init__(self, etcd: Etcd, prefix: str) -> None:
        self.changes: asyncio.Queue[dict[str, Entry]] = asyncio.Queue()
        self._etcd, self._prefix, self._tell = etcd, prefix, in_loop(self.changes.put_nowait)
        self._over = threading.Event()
        self._connection: http.client.HTTPConnection | None = None
        self._thread = threading.Thread(target=self._run, name="cm-etcd-watch", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """The thread ends soon."""
        self._over.set()
        if self._connection is not None and self._connection.sock is not None:
            with contextlib.suppress(OSError):
                self._connection.sock.shutdown(socket.SHUT_RDWR)

    def _run(self) -> None:
        revision, number = 0, self._etcd._first
        while not self._over.is_set():
            try:
                for found in self._answers(number, revision):
                    if found.get("canceled"):  # compacted: what was missed is read anew
                        revision = 0
                        break
                    if found.get("events") or not revision:
                        self._tell(_entries(event["kv"] for event in found["events"]) if revision else {})
                    revision = int(found["header"]["revision"])
            except (OSError, http.client.HTTPException, ValueError, KeyError, StoreRefused, _Failed) as error:
                if not isinstance(error, TimeoutError):
                    self._tell({})
                    self._over.wait(0.5)
            number += 1

    def _answers(self, number: int, revision: int) -> Iterator[dict[str, Any]]:
        asked = {**_range(self._prefix), **({"start_revision": str(revision + 1)} if revision else {})}
        self._connection, answer = self._etcd.opened(number, json.dumps({"create_request": asked}).encode())
        try:
            while not self._over.is_set() and (line := answer.readline()):
                yield _parsed(line, answer.status)["result"]
        finally:
            self._connection.close()


def _parsed(data: bytes, status: int) -> dict[str, Any]:
    try:
        found = json.loads(data)
    except ValueError:
        raise _Failed(_ANOTHER_MEMBER[1], f"HTTP {status}: {data[:80]!r}") from None
    failed = found.get("error")
    if failed:
        about = failed if isinstance(failed, dict) else found
        code = about.get("code", about.get("grpc_code"))
        raise _Failed(2 if code is None else int(code), str(about.get("message") or failed))
    return dict(found)


def _explained(said: str) -> str:
    if "too many operations" in said:
        return f"{said}: start etcd with --max-txn-ops, or change fewer boards at a time (docs/fleet.md)"
    return said


def _tls(cluster: Cluster) -> ssl.SSLContext | None:
    if not any(member.startswith("https") for member in cluster.members):
        return None
    try:
        context = ssl.create_default_context(cafile=cluster.cacert or None)
        if cluster.cert:
            context.load_cert_chain(cluster.cert, cluster.key or None)
    except OSError as error:
        raise InvalidRequest(f"etcd's certificates ({cluster.cacert}, {cluster.cert}): {error}") from None
    return context


def _key(text: str) -> str:
    return base64.b64encode((PREFIX + text).encode()).decode()


def _text(coded: str) -> str:
    return base64.b64decode(coded).decode()


def _entries(kvs: Iterable[Mapping[str, Any]]) -> dict[str, Entry]:
    return {_text(kv["key"])[len(PREFIX) :]: Entry(_text(kv.get("value", "")), int(kv["mod_revision"])) for kv in kvs}


def _range(prefix: str) -> dict[str, Any]:
    """All keys that begin so: up to the first text behind them."""
    last = (PREFIX + prefix).encode()
    return {"key": _key(prefix), "range_end": base64.b64encode(last[:-1] + bytes([last[-1] + 1])).decode()}


def _put(k: str, put: Put | None) -> dict[str, Any]:
    if put is None:
        return {"request_delete_range": {"key": _key(k)}}
    return {
        "request_put": {
            "key": _key(k), "value": base64.b64encode(put.value.encode()).decode(), "lease": put.lease or "0"
        }
    }  # fmt: skip
