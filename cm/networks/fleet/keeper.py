# SPDX-License-Identifier: Apache-2.0
"""The keeper: a store in one process of the fleet, in SQLite, with the operations offered over zenoh.

It is a single place: while it is away no change of many boards begins. Leases run by its monotonic clock, and begin
anew with it, so that no time lies on the disk.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import queue
import sqlite3
import time
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from cm.errors import Busy, CmError, InvalidRequest
from cm.networks.fleet import queries
from cm.networks.fleet.etcd import Cluster, Etcd
from cm.networks.fleet.keys import STORE
from cm.networks.fleet.store import BOARDS, Entry, Expect, Put, Puts, Store, StoreAway, StoreRefused, key
from cm.networks.fleet.zenoh_session import Network, in_loop, is_alive, metadata_of, zenoh_module

KEEPER = "keeper"  # what names it as the store
_LOG = logging.getLogger("cm.fleet")
_TIMEOUT = 3.0  # seconds for an answer
_TICK = 0.25  # seconds between two looks at leases
_PAGES = 64  # of 4 KiB, to which the log of what is not in the file yet grows: SQLite's 1000 fill a small disk for good
_CHANGED, _ALIVE = f"{STORE}/changed", f"{STORE}/alive"
OPERATIONS = ("get", "join", "txn", "claim", "keep", "revoke")  # the first two are a board's, the first a reader's
_UNREADABLE = (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RecursionError, sqlite3.Error)
_TABLES = """
CREATE TABLE IF NOT EXISTS entries (key TEXT PRIMARY KEY, value TEXT, revision INTEGER, lease TEXT) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS leases (id TEXT PRIMARY KEY, seconds REAL);
CREATE TABLE IF NOT EXISTS counter (revision INTEGER);
INSERT INTO counter SELECT 0 WHERE NOT EXISTS (SELECT * FROM counter);
"""


class Ledger:
    """The store itself, on one file. For one thread at a time."""

    def __init__(
        self, path: Path | str, changed: Callable[[dict[str, Entry]], None], now: Callable[[], float] = time.monotonic
    ) -> None:
        """`changed` is told of each transaction as `Store.watch` does. Raises StoreRefused if the file is no store."""
        self._changed, self._now = changed, now
        try:
            self._file = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        except sqlite3.Error as error:
            raise StoreRefused(f"{path}: {error}") from None
        try:
            self._file.execute("PRAGMA journal_mode=WAL")
            self._file.execute("PRAGMA synchronous=FULL")  # a transaction that was answered outlives a loss of power
            self._file.execute(f"PRAGMA wal_autocheckpoint={_PAGES}")
            self._file.executescript(_TABLES)
            leases = self._file.execute("SELECT id, seconds FROM leases").fetchall()
        except sqlite3.Error as error:
            self._file.close()
            raise StoreRefused(f"{path}: {error}") from None
        self._ends = {lease: (now() + seconds, seconds) for lease, seconds in leases}

    def close(self) -> None:
        """Everything that was answered is on the disk."""
        self._file.close()

    def get(self, prefix: str) -> dict[str, Entry]:
        found = self._file.execute(
            "SELECT key, value, revision FROM entries WHERE substr(key, 1, ?) = ?", (len(prefix), prefix)
        )
        return {k: Entry(value, revision) for k, value, revision in found}

    def txn(self, expect: Expect, puts: Puts, lease: str = "", seconds: float = 0.0) -> int:
        """`lease`: is granted for `seconds` with it."""
        end = self._now() + seconds
        with self._file:
            self._file.execute("BEGIN IMMEDIATE")
            for name, revision in expect.items():
                row = self._file.execute("SELECT revision FROM entries WHERE key = ?", (name,)).fetchone()
                if (row[0] if row else 0) != revision:
                    return 0
            unknown = {put.lease for put in puts.values() if put and put.lease} - {*self._ends, lease}
            if unknown:
                raise StoreRefused(f"lease {unknown.pop()} has ended")
            if lease:
                self._file.execute("INSERT OR REPLACE INTO leases VALUES (?, ?)", (lease, seconds))
            revision, changes = self._put(puts)
        if lease:
            self._ends[lease] = (end, seconds)
        self._changed(changes)
        return revision

    def _put(self, puts: Puts) -> tuple[int, dict[str, Entry]]:
        self._file.execute("UPDATE counter SET revision = revision + 1")
        revision = int(self._file.execute("SELECT revision FROM counter").fetchone()[0])
        for name, put in puts.items():
            if put is None:
                self._file.execute("DELETE FROM entries WHERE key = ?", (name,))
            else:
                row = (name, put.value, revision, put.lease)
                self._file.execute("INSERT OR REPLACE INTO entries VALUES (?, ?, ?, ?)", row)
        return revision, {name: Entry(put.value if put else "", revision) for name, put in puts.items()}

    def claim(self, expect: Expect, puts: Puts, lease: str, seconds: float) -> dict[str, Entry]:
        self.txn(expect, puts, lease, seconds)
        return self.get("")

    def keep(self, lease: str) -> bool:
        self.expire()
        found = self._ends.get(lease)
        if found:
            self._ends[lease] = (self._now() + found[1], found[1])
        return found is not None

    def revoke(self, lease: str) -> None:
        with self._file:
            self._file.execute("BEGIN IMMEDIATE")
            keys = [row[0] for row in self._file.execute("SELECT key FROM entries WHERE lease = ?", (lease,))]
            self._file.execute("DELETE FROM leases WHERE id = ?", (lease,))
            changes = self._put(dict.fromkeys(keys))[1] if keys else {}
        self._ends.pop(lease, None)
        self._changed(changes)

    def expire(self) -> None:
        """End the leases whose time is over."""
        for lease in [lease for lease, (end, _) in self._ends.items() if self._now() >= end]:
            self.revoke(lease)


class Keeper:
    """Offers a ledger in a zenoh session, from a thread of its own. Raises Busy if the fleet has a keeper.

    `ended` is that thread's: whoever has a keeper ends with it.
    """

    def __init__(self, session: Any, path: Path) -> None:
        if is_alive(session, _ALIVE):
            raise Busy("this fleet has a keeper already: one only keeps the wanted state")
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._session = session
        self._ledger = Ledger(path, self._tell)
        self._queries: queue.SimpleQueue[Any] = queue.SimpleQueue()
        came = zenoh_module().handlers.Callback(self._queries.put, indirect=False)
        self._queryable = session.declare_queryable(f"{STORE}/*/*", came, complete=True)
        self._thread = ThreadPoolExecutor(1, "cm-keeper")
        self.ended = self._thread.submit(self._run)
        self._token = session.liveliness().declare_token(_ALIVE)

    def close(self) -> None:
        """Offer nothing more."""
        self._token.undeclare()
        self._queryable.undeclare()
        self._queries.put(None)
        self._thread.shutdown()
        self._ledger.close()

    def _run(self) -> None:
        """What a disk or the network does not take costs one answer, or one look at leases, and is tried again."""
        said = ""
        while True:
            try:
                with contextlib.suppress(queue.Empty):
                    query = self._queries.get(timeout=_TICK)
                    if query is None:
                        return
                    with query:
                        answer = json.dumps(self._answer(str(query.key_expr), query.payload)).encode()
                        query.reply(str(query.key_expr), answer, encoding="application/json")
                self._ledger.expire()
            except (sqlite3.Error, zenoh_module().ZError) as error:
                if str(error) != said:
                    _LOG.warning("the keeper: %s; it is tried again", error)
                said = str(error)
            else:
                said = ""

    def _tell(self, changes: dict[str, Entry]) -> None:
        for name, entry in changes.items():
            self._session.put(f"{_CHANGED}/{name}", json.dumps(entry).encode())

    def _answer(self, where: str, payload: Any) -> dict[str, Any]:
        try:
            operation, caller = where.split("/")[1:]
            done = self._done(operation, caller, json.loads(bytes(payload)) if payload is not None else {})
            return {"ok": done, "now": time.time()}
        except CmError as error:
            return {"code": error.code, "error": str(error)}
        except sqlite3.OperationalError as error:
            return {"code": StoreRefused.code, "error": f"the keeper cannot write: {error}"}
        except _UNREADABLE as error:
            return {"code": "invalid_request", "error": f"{type(error).__name__}: {error}"}

    def _done(self, operation: str, caller: str, asked: dict[str, Any]) -> Any:
        if operation not in OPERATIONS:
            raise InvalidRequest(f"the keeper has {', '.join(OPERATIONS)}, and no {operation}")
        if operation == "join":
            operation, asked = "txn", {"expect": {}, "puts": {key(caller, "settings"): [asked["settings"], ""]}}
        if "puts" in asked:
            asked["puts"] = {k: None if put is None else Put(*map(str, put)) for k, put in asked["puts"].items()}
            _check_names(asked["puts"], caller)
        return getattr(self._ledger, operation)(**asked)


def _check_names(puts: Puts, caller: str) -> None:
    """What is wanted is wanted in one's own name: boards obey by it. Raises StoreRefused."""
    for name, put in puts.items():
        if put is not None and name.startswith(BOARDS) and name.endswith(("/wanted", "/claim")):
            said = json.loads(put.value).get("by")
            if said != caller:
                raise StoreRefused(f"{name}: {caller} cannot want something in the name of {said}")


class KeeperStore:
    """The keeper's operations, as Store has them, for a client or a board of that name."""

    def __init__(self, session: Any, caller: str) -> None:
        self._session, self._caller = session, caller
        self._ahead = 0.0  # the keeper's clock, of our monotonic one

    async def get(self, prefix: str) -> dict[str, Entry]:
        return _entries(await self._ask("get", prefix=prefix))

    async def txn(self, expect: Expect, puts: Puts) -> int:
        return int(await self._ask("txn", expect=dict(expect), puts=dict(puts)))

    async def join(self, board: str, settings: str) -> None:  # noqa: ARG002 (the caller's name is the board's)
        await self._ask("join", settings=settings)

    async def claim(self, expect: Expect, puts: Puts, lease: str, seconds: int) -> dict[str, Entry]:
        return _entries(await self._ask("claim", expect=dict(expect), puts=dict(puts), lease=lease, seconds=seconds))

    async def keep(self, lease: str) -> bool:
        return bool(await self._ask("keep", lease=lease))

    async def revoke(self, lease: str) -> None:
        await self._ask("revoke", lease=lease)

    def now(self) -> float:
        return time.monotonic() + self._ahead

    async def close(self) -> None:
        """The session is not ours."""

    async def watch(self, prefix: str) -> AsyncIterator[dict[str, Entry]]:
        """As Store has it; the keeper's coming back is a gap, too."""
        changes: asyncio.Queue[dict[str, Entry]] = asyncio.Queue()
        tell = in_loop(changes.put_nowait)

        def came(sample: Any) -> None:
            tell({str(sample.key_expr)[len(_CHANGED) + 1 :]: Entry(*json.loads(bytes(sample.payload)))})

        tell({})
        subscriber = self._session.declare_subscriber(f"{_CHANGED}/{prefix.rstrip('/')}/**", came)
        keeper = self._session.liveliness().declare_subscriber(_ALIVE, lambda _: tell({}))
        try:
            while True:
                yield await changes.get()
        finally:
            subscriber.undeclare()
            keeper.undeclare()

    async def _ask(self, operation: str, **what: Any) -> Any:
        asked = json.dumps(what).encode()
        where = f"{STORE}/{operation}/{self._caller}"
        found = [each async for each in queries.answers(self._session, where, asked, timeout=_TIMEOUT)]
        if not found:
            raise StoreAway("the fleet's keeper does not answer: `cm bridge fleet --keeper` runs on one board, or the "
                            "router's rules keep us off")  # fmt: skip
        answer = json.loads(found[0].payload or b"{}")
        if "error" in answer:
            raise StoreRefused(str(answer["error"]))
        self._ahead = float(answer["now"]) - time.monotonic()
        return answer["ok"]


def _entries(found: Mapping[str, Any]) -> dict[str, Entry]:
    return {k: Entry(*entry) for k, entry in found.items()}


def opened_store(network: Network, opened: Any, caller: str) -> Store:
    """Where the wanted state is, for a caller: the keeper, reached through the session `opened`, or etcd.

    Raises InvalidRequest.
    """
    store = network.store or os.environ.get("CM_FLEET_STORE") or metadata_of(network.config, "store") or KEEPER
    return KeeperStore(opened, caller) if store == KEEPER else Etcd(Cluster.read(store))
