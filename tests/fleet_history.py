# SPDX-License-Identifier: Apache-2.0
"""Whether what clients saw of a store can have happened in one order: linearizability.

The algorithm is that of Wing and Gong with Lowe's memory of what was tried ("Testing for linearizability", 2017), as
in porcupine (Go) and Knossos (Clojure); Python has no library of it. Here the object is the whole store, without what
lies under leases: the store takes that away by itself.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from cm.networks.fleet.store import Entry, Put, Store

State = tuple[tuple[str, str], ...]  # keys and values, sorted
NEVER = float("inf")


@dataclass(frozen=True, slots=True)
class Operation:
    """What a client asked, and was told. Without an end, its effect may come at any time, or never."""

    begun: float  # CLOCK_MONOTONIC of this machine
    ended: float
    kind: str  # get, txn
    seen: State = ()  # of a get
    expect: tuple[tuple[str, str | None], ...] = ()  # of a txn: values that were compared; None: absent
    puts: tuple[tuple[str, str | None], ...] = ()

    def after(self, state: State) -> State | None:
        """The state after it; None if it cannot have said what it said."""
        if self.kind == "get":
            return state if self.seen == state else None
        now = dict(state)
        if any(now.get(key) != value for key, value in self.expect):
            return None
        for key, value in self.puts:
            if value is None:
                now.pop(key, None)
            else:
                now[key] = value
        return tuple(sorted(now.items()))


def linearizable(history: Iterable[Operation], start: State = ()) -> bool:
    """Whether there is an order that fits what all were told, and in which nothing comes before what had ended."""
    left = tuple(sorted(history, key=lambda each: each.begun))
    certain = frozenset(n for n, each in enumerate(left) if each.ended < NEVER)
    tried: set[tuple[frozenset[int], State]] = set()
    stack: list[tuple[frozenset[int], State]] = [(frozenset(range(len(left))), start)]
    while stack:
        todo, state = stack.pop()
        if not todo & certain:
            return True
        if (todo, state) in tried:
            continue
        tried.add((todo, state))
        first = min(left[n].ended for n in todo)
        for n in todo:
            if left[n].begun <= first and (after := left[n].after(state)) is not None:
                stack.append((todo - {n}, after))
    return False


# ---- how it is written down -------------------------------------------------------------------


def kept(key: str) -> bool:
    """Whether a key belongs to the object that is checked."""
    return not key.endswith(("/claim", "/settings"))


class Recording:
    """A store that writes down what it is asked and what it says, a line for each beginning and each end."""

    def __init__(self, inner: Store, file: TextIO) -> None:
        self._inner, self._file, self._number = inner, file, 0
        self._values: dict[tuple[str, int], str] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def _begin(self, **what: Any) -> int:
        self._number += 1
        self._line(number=self._number, begun=time.monotonic(), **what)
        return self._number

    def _line(self, **what: Any) -> None:
        self._file.write(json.dumps(what) + "\n")
        self._file.flush()

    async def get(self, prefix: str) -> dict[str, Entry]:
        """Only a get of everything is a part of the history."""
        number = self._begin(kind="get") if not prefix else 0
        found = await self._inner.get(prefix)
        if number:
            self._line(number=number, ended=time.monotonic(), seen={k: e.value for k, e in found.items() if kept(k)})
        self._values |= {(k, entry.revision): entry.value for k, entry in found.items()}
        return found

    async def txn(self, expect: Mapping[str, int], puts: Mapping[str, Put | None]) -> int:
        """A repetition is an operation of its own."""
        values = {k: self._values.get((k, r)) if r else None for k, r in expect.items() if kept(k)}
        plain = {k: put.value if put else None for k, put in puts.items() if kept(k)}
        number = self._begin(kind="txn", expect=values, puts=plain)
        revision = await self._inner.txn(expect, puts)
        self._line(number=number, ended=time.monotonic(), done=bool(revision))
        return revision


def read(files: Sequence[Path]) -> Iterator[Operation]:
    """The operations that some clients wrote down; of one that was killed, the last may have no end."""
    for path in files:
        known: dict[int, dict[str, Any]] = {}
        for line in path.read_text(encoding="utf-8").splitlines():
            said = json.loads(line)
            known.setdefault(said["number"], {}).update(said)
        for each in known.values():
            if each["kind"] == "get" and "ended" not in each:
                continue
            lost = each["kind"] == "txn" and not each.get("done")  # it was done before its answer was lost, or never
            ended = NEVER if lost else each["ended"]
            yield Operation(
                each["begun"], ended, each["kind"], tuple(sorted(each.get("seen", {}).items())),
                tuple(each.get("expect", {}).items()), tuple(each.get("puts", {}).items()),
            )  # fmt: skip
