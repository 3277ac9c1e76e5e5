# SPDX-License-Identifier: Apache-2.0
"""A store on etcd (3.4 and later), over its JSON gateway: HTTP/1.1, one connection for each request or watch at a time.

The gateway: https://etcd.io/docs/v3.4/dev-guide/api_grpc_gateway/. Its keys and values are base64, its numbers text.
"""

from __future__ import annotations

import asyncio
import base64
import json
import logging
import ssl
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from email.utils import mktime_tz, parsedate_tz
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from cm.errors import InvalidRequest
from cm.networks.fleet.store import BOARDS, Entry, Expect, Put, Puts, StoreAway, StoreRefused, key

_LOG = logging.getLogger("cm.fleet")
PREFIX = "cm/"  # of all our keys: others may use the same cluster
_ONE = 2.0  # seconds for one member's answer
_SOON = 0.3  # and for that of one of which nothing was heard: one that is stopped takes connections, too
_REPEATABLE = ("kv/range", "lease/grant")  # requests that may be made twice: a lease that is not used runs out
_ALL = 8.0  # and for that of any
_MANY = 3.0  # more for an answer with all boards
_PACE = 200e3  # bytes a second of a large request, beyond that
_QUIET = 15.0  # seconds without a word after which a watch asks another member
_PAUSE, _LONGEST_PAUSE = 0.5, 8.0  # seconds until a watch that failed is asked for again; doubled with each refusal
_ANOTHER_MEMBER = (4, 14)  # gRPC's DEADLINE_EXCEEDED, UNAVAILABLE: another member may do it
_UNAUTHENTICATED = 16
_NOT_FOUND = 5
_LOGIN = "auth/authenticate"
_BROKEN = (OSError, EOFError, ValueError, asyncio.TimeoutError)  # a member that hangs, or speaks no HTTP


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

    def tls(self) -> ssl.SSLContext | None:
        """None without https. Raises InvalidRequest for files that cannot be used."""
        if not any(member.startswith("https") for member in self.members):
            return None
        try:
            context = ssl.create_default_context(cafile=self.cacert or None)
            if self.cert:
                context.load_cert_chain(self.cert, self.key or None)
        except OSError as error:
            raise InvalidRequest(f"etcd's certificates ({self.cacert}, {self.cert}): {error}") from None
        return context


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


class _Connection:
    """To one member: a request, and after its whole answer the next."""

    def __init__(self, member: str, tls: ssl.SSLContext | None) -> None:
        self.member, self._tls = member, tls
        self._stream: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self.ahead = 0.0  # the member's clock, of our monotonic one, as its last answer told it to half a second

    async def posted(self, path: str, body: bytes, token: str) -> AsyncIterator[bytes]:
        """The pieces of the answer as they come. Raises those of `_BROKEN`."""
        where = urlsplit(self.member)
        if self._stream is None:
            tls = self._tls if where.scheme == "https" else None
            self._stream = await asyncio.open_connection(where.hostname, where.port or 2379, ssl=tls)
        reader, writer = self._stream
        head = (
            f"POST /v3/{path} HTTP/1.1", f"Host: {where.netloc}", "Content-Type: application/json",
            f"Content-Length: {len(body)}", *((f"Authorization: {token}",) if token else ()), "\r\n",
        )  # fmt: skip
        writer.write("\r\n".join(head).encode() + body)
        said = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
        if date := parsedate_tz(said.partition("\r\ndate:")[2].partition("\r\n")[0]):
            self.ahead = mktime_tz(date) + 0.5 - time.monotonic()
        _, _, length = said.partition("\r\ncontent-length:")
        if length:
            yield await reader.readexactly(int(length.split()[0]))
            return
        size = -1  # "transfer-encoding: chunked"
        while size:
            size = int(await reader.readline(), 16)
            yield (await reader.readexactly(size + 2))[:-2]

    def close(self) -> None:
        """At the loop's next turn, without TLS's farewell, which nobody would wait for. Twice is fine."""
        if self._stream is not None:
            self._stream[1].transport.abort()


class Etcd:
    """The store of `cm.networks.fleet.store`; each member is tried until one answers."""

    def __init__(self, cluster: Cluster) -> None:
        """Raises InvalidRequest for files that cannot be used; nothing is connected yet."""
        self._cluster, self._tls = cluster, cluster.tls()
        self._idle: list[_Connection] = []
        self._first = 0  # the member that answered last
        self._heard = False  # of any
        self._token = ""
        self._ahead = 0.0
        self._closed = False

    async def get(self, prefix: str) -> dict[str, Entry]:
        found = await self._ask("kv/range", _range(prefix), 0.0 if prefix.endswith("/") and prefix != BOARDS else _MANY)
        return _entries(found.get("kvs", ()))

    async def txn(self, expect: Expect, puts: Puts) -> int:
        found = await self._txn(expect, puts, ())
        return int(found["header"]["revision"]) if found.get("succeeded") else 0

    async def claim(self, expect: Expect, puts: Puts, lease: str, seconds: int) -> dict[str, Entry]:
        """The lease comes first: a transaction that names one that is not there would be the end of some members."""
        try:
            await self._ask("lease/grant", {"ID": lease, "TTL": str(seconds)})
        except StoreRefused as error:
            if "already exists" not in str(error):  # by a request whose answer was lost
                raise
        found = await self._txn(expect, puts, ({"request_range": _range("")},))
        return _entries(found["responses"][-1]["response_range"].get("kvs", ()))

    async def _txn(self, expect: Expect, puts: Puts, reads: tuple[Mapping[str, Any], ...]) -> dict[str, Any]:
        """A repetition after a lost answer fails if the compares name a key that it puts."""
        compare = [
            {"key": _key(k), "target": "MOD", "result": "EQUAL", "mod_revision": str(revision)}
            for k, revision in expect.items()
        ]
        success = [*(_put(k, put) for k, put in puts.items()), *reads]
        slow = _MANY if reads else 0.0
        return await self._ask("kv/txn", {"compare": compare, "success": success, "failure": reads}, slow)

    async def join(self, board: str, settings: str) -> None:
        """The role of a board's user lets it write that key only."""
        await self.txn({}, {key(board, "settings"): Put(settings)})

    async def keep(self, lease: str) -> bool:
        return int((await self._ask("lease/keepalive", {"ID": lease})).get("result", {}).get("TTL", 0)) > 0

    async def revoke(self, lease: str) -> None:
        with suppress(_Gone):
            await self._ask("lease/revoke", {"ID": lease})

    def now(self) -> float:
        return time.monotonic() + self._ahead

    async def close(self) -> None:
        self._closed = True
        while self._idle:
            self._idle.pop().close()
        await asyncio.sleep(0)

    async def watch(self, prefix: str) -> AsyncIterator[dict[str, Entry]]:
        """It resumes where it was, at another member if one is silent. Where etcd refuses, that is asked again.

        Of that it tells nothing but a gap, so that whoever listens reads, and learns the reason.
        """
        revision, number, pause, said = 0, self._first, _PAUSE, ""
        while not self._closed:
            asked = {**_range(prefix), **({"start_revision": str(revision + 1)} if revision else {})}
            connection = _Connection(self._cluster.members[number % len(self._cluster.members)], self._tls)
            number += 1
            try:
                async for found in self._told(connection, {"create_request": asked}):
                    if found.get("canceled"):
                        if not int(found.get("compact_revision", 0)):
                            raise _Failed(_UNAUTHENTICATED, str(found.get("cancel_reason") or "it gives no reason"))
                        revision = 0  # what was missed is read anew
                        break
                    if found.get("events") or not revision:
                        yield _entries(event["kv"] for event in found["events"]) if revision else {}
                    revision, pause, said = int(found["header"]["revision"]), _PAUSE, ""
            except asyncio.TimeoutError:
                pass
            except (*_BROKEN, KeyError, _Failed) as error:
                yield {}
                if isinstance(error, _Failed) and error.code not in _ANOTHER_MEMBER:
                    self._token = ""
                    if str(error) != said:
                        _LOG.warning("etcd does not tell what changes under %s: %s", PREFIX + prefix, error)
                    said, pause = str(error), min(2 * pause, _LONGEST_PAUSE)
                await asyncio.sleep(pause)
            finally:
                connection.close()

    async def _told(self, connection: _Connection, asked: Mapping[str, Any]) -> AsyncIterator[dict[str, Any]]:
        """The messages of a stream, each a line. Raises `asyncio.TimeoutError` if there is none for long, EOFError."""
        pieces, left = connection.posted("watch", _json(asked), await self._logged_in(connection)), b""
        while piece := await asyncio.wait_for(anext(pieces, b""), _QUIET):
            *lines, left = (left + piece).split(b"\n")
            for line in lines:
                yield _parsed(line)["result"]
        raise EOFError("the member ended the watch")

    # ---- requests -------------------------------------------------------------------------

    async def _ask(self, path: str, body: Mapping[str, Any], slow: float = 0.0) -> dict[str, Any]:
        data, members = _json(body), self._cluster.members
        slow += len(data) / _PACE
        end, said, number = time.monotonic() + _ALL + 2 * slow, "", self._first
        hasty = path in _REPEATABLE and len(members) > 1 and not self._heard
        patience = _SOON if hasty else _ONE + slow
        while True:
            try:
                found = await asyncio.wait_for(self._of_member(members[number], path, data), patience)
            except _BROKEN as error:
                said = str(error) or type(error).__name__
            except _Failed as error:
                said = str(error)
                if error.code == _UNAUTHENTICATED and self._token:
                    self._token = ""
                elif error.code not in _ANOTHER_MEMBER:
                    if "too many operations" in said:
                        said += ": start etcd with --max-txn-ops, or change fewer boards at a time (docs/fleet.md)"
                    raise (_Gone if error.code == _NOT_FOUND else StoreRefused)(said) from None
            else:
                self._first, self._heard = number, True
                return found
            patience = _ONE + slow
            if time.monotonic() > end or self._closed:
                raise StoreAway(f"etcd does not answer at {', '.join(members)}: {said}")
            number = (number + 1) % len(members)
            if number == self._first:  # all of them
                await asyncio.sleep(0.1)

    async def _of_member(self, member: str, path: str, data: bytes) -> dict[str, Any]:
        """On a connection that is idle, or a new one: one that was closed meanwhile is as a member that is away."""
        connection = next((each for each in self._idle if each.member == member), None)
        if connection is None:
            connection = _Connection(member, self._tls)
        else:
            self._idle.remove(connection)
        try:
            token = "" if path == _LOGIN else await self._logged_in(connection)
            answer = b"".join([piece async for piece in connection.posted(path, data, token)])
        except BaseException:
            connection.close()
            raise
        self._idle.append(connection)
        self._ahead = connection.ahead
        return _parsed(answer)

    async def _logged_in(self, connection: _Connection) -> str:
        """The user's token, which is fetched where there is none."""
        if self._cluster.user and not self._token:
            word = Path(self._cluster.password_file).read_text(encoding="utf-8").strip()
            asked = _json({"name": self._cluster.user, "password": word})
            self._token = (await self._of_member(connection.member, _LOGIN, asked))["token"]
        return self._token


class _Gone(StoreRefused):
    """A lease that has ended."""


def _parsed(data: bytes) -> dict[str, Any]:
    """Raises _Failed, ValueError."""
    found = json.loads(data)
    failed = found.get("error")
    if failed:
        about = failed if isinstance(failed, dict) else found
        code = about.get("code", about.get("grpc_code"))
        raise _Failed(2 if code is None else int(code), str(about.get("message") or failed))
    return dict(found)


def _json(asked: Mapping[str, Any]) -> bytes:
    return json.dumps(asked).encode()


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
