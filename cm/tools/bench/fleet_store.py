# SPDX-License-Identifier: Apache-2.0
"""Where a store of a fleet ends: what a change of many boards asks of it.

Measured: everything read, and the two transactions of a change, by number of boards. The rest is reckoned: what lies
in it, and what boards read when a change is decided.
"""

from __future__ import annotations

import asyncio
import shutil
import statistics
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from cm.networks.fleet.etcd import Cluster, Etcd
from cm.networks.fleet.keeper import Ledger
from cm.networks.fleet.store import (
    GENERATION,
    Claim,
    Put,
    Puts,
    Settings,
    Store,
    Wanted,
    key,
    packed,
)  # fmt: skip

SIZES = (10, 50, 1_000, 10_000)
_LARGE = ("--max-txn-ops=50000", "--max-request-bytes=33554432")  # what etcd needs for a change of so many
_PIECE = 100  # boards that are put at a time while the store is filled


async def filled(store: Store, boards: int) -> None:
    """The inventory of so many boards, each wanted somewhere."""
    where = packed(Wanted(1, "camera", "edge_detection", "anna", "anna-12345678"))
    for first in range(0, boards, _PIECE):
        names = [f"b{number:05}" for number in range(first, min(boards, first + _PIECE))]
        puts: dict[str, Put | None] = {key(name, "settings"): Put(packed(Settings(("line1",)))) for name in names}
        await store.txn({}, puts)
        await store.txn({}, {key(name, "wanted"): Put(where) for name in names})


async def measured(store: Store, boards: int, rounds: int = 5) -> dict[str, Any]:
    """Seconds (medians) of reading all, of opening a change of all, and of deciding it; bytes of values and keys."""
    await filled(store, boards)
    names = [f"b{number:05}" for number in range(boards)]
    took: dict[str, list[float]] = {"read": [], "open": [], "decide": []}
    found = await store.get("")
    for number in range(rounds):
        lease = str(number + 1)
        claim = Put(packed(Claim(number + 2, "anna-12345678", "anna")), lease)
        where = packed(Wanted(number + 2, "camera", "edge_detection", "anna", "anna-12345678"))
        puts: dict[str, Put | None] = {key(name, "claim"): claim for name in names}
        found = await _timed(took["read"], lambda: store.get(""))
        claims: Puts = {GENERATION: Put("1"), **puts}
        there = await _timed(took["open"], lambda p=claims, at=lease: store.claim({}, p, at, 600))  # type: ignore[misc]
        opened = there[GENERATION].revision
        expect = {key(name, "wanted"): found[key(name, "wanted")].revision for name in names}
        expect |= {key(name, "claim"): opened for name in names}
        decided = {key(name, "wanted"): Put(where) for name in names}
        done = await _timed(took["decide"], lambda e=expect, d=decided: store.txn(e, d))  # type: ignore[misc]
        assert done, "the transaction of a change that nobody disturbed was refused"
        await store.revoke(lease)
    size = sum(len(name) + len(entry.value) for name, entry in found.items())
    return {"boards": boards, **{what: statistics.median(each) for what, each in took.items()}, "bytes": size}


async def _timed(into: list[float], work: Callable[[], Awaitable[Any]]) -> Any:
    begun = time.perf_counter()
    found = await work()
    into.append(time.perf_counter() - begun)
    return found


def rows(folder: Path, sizes: tuple[int, ...] = SIZES) -> list[dict[str, Any]]:
    """Both stores for each number of boards, on this disk and without a network; etcd if it is installed."""
    from cm.tools.demo.boards import local_etcd

    found = [{"store": "keeper", **asyncio.run(measured(_Ledger(folder / f"{n}.sqlite"), n))} for n in sizes]
    for n in sizes if shutil.which("etcd") else ():
        with local_etcd(folder / f"etcd{n}", _LARGE) as url:
            found.append({"store": "etcd", **asyncio.run(_of_etcd(url, n))})
    return found


async def _of_etcd(url: str, boards: int) -> dict[str, Any]:
    store = Etcd(Cluster((url,)))
    try:
        return await measured(store, boards)
    finally:
        await store.close()


class _Ledger:
    """The keeper's file, without the network before it."""

    def __init__(self, path: Path) -> None:
        self._ledger = Ledger(path, lambda _: None)

    def __getattr__(self, name: str) -> Any:
        async def call(*arguments: Any) -> Any:
            return getattr(self._ledger, name)(*arguments)

        return call
