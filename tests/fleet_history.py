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

from cm.networks.fleet.store import Entry, Expect, Puts, Store

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
    """Whether there is an order that fits what all were told, and in which nothing comes before what had ended.

    What is done of a history is nearly its beginning: a place is remembered as that, and what differs from it. Whole
    sets of what is left would take 8 GB for the history of 75 rounds.
    """
    left = tuple(sorted(history, key=lambda each: each.begun))
    tried: set[tuple[Place, State]] = set()
    stack = [(Place().onwards(left), start)]
    while stack:
        place, state = stack.pop()
        if place.begin == len(left):
            return True
        if (place, state) not in tried:
            tried.add((place, state))
            stack += _next(left, place, state)
    return False


@dataclass(frozen=True, slots=True)
class Place:
    """How far an order has come: all before `begin` is done but for `skipped`, and beyond that only `done` is.

    `skipped` have no end, and may come at any time, or never.
    """

    begin: int = 0
    skipped: frozenset[int] = frozenset()
    done: frozenset[int] = frozenset()

    def onwards(self, left: Sequence[Operation]) -> Place:
        """The same, with the beginning as long as it can be."""
        begin, skipped, done = self.begin, self.skipped, self.done
        while begin < len(left) and (begin in done or left[begin].ended == NEVER):
            skipped |= {begin} - done
            done -= {begin}
            begin += 1
        return Place(begin, skipped, done)

    def after(self, number: int, left: Sequence[Operation]) -> Place:
        """With one more that is done."""
        if number in self.skipped:
            return Place(self.begin, self.skipped - {number}, self.done)
        return Place(self.begin, self.skipped, self.done | {number}).onwards(left)


def _next(left: Sequence[Operation], place: Place, state: State) -> list[tuple[Place, State]]:
    """What may come next: whatever began before the first of what is left had ended."""
    first, begun = NEVER, [*place.skipped]
    for number in range(place.begin, len(left)):
        if left[number].begun > first:
            break
        if number not in place.done:
            begun.append(number)
            first = min(first, left[number].ended)
    found = []
    for number in begun:
        if left[number].begun <= first and (after := left[number].after(state)) is not None:
            found.append((place.after(number, left), after))
            if after is state:  # it saw what there is, and changes nothing: whatever follows may follow it
                return found[-1:]
    return found


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
        self._saw(number, found)
        return found

    def _saw(self, number: int, found: Mapping[str, Entry]) -> None:
        if number:
            self._line(number=number, ended=time.monotonic(), seen={k: e.value for k, e in found.items() if kept(k)})
        self._values |= {(k, entry.revision): entry.value for k, entry in found.items()}

    def _expected(self, expect: Expect) -> dict[str, str | None]:
        return {k: self._values.get((k, r)) if r else None for k, r in expect.items() if kept(k)}

    async def txn(self, expect: Expect, puts: Puts) -> int:
        """A repetition is an operation of its own."""
        plain = {k: put.value if put else None for k, put in puts.items() if kept(k)}
        number = self._begin(kind="txn", expect=self._expected(expect), puts=plain)
        revision = await self._inner.txn(expect, puts)
        self._line(number=number, ended=time.monotonic(), done=bool(revision))
        return revision

    async def claim(self, expect: Expect, puts: Puts, lease: str, seconds: int) -> dict[str, Entry]:
        """A transaction, and what there was after it; with our claims, if it was done."""
        plain = {k: put.value if put else None for k, put in puts.items() if kept(k)}
        number, seen = self._begin(kind="txn", expect=self._expected(expect), puts=plain), self._begin(kind="get")
        found = await self._inner.claim(expect, puts, lease, seconds)
        done = all(found.get(k, Entry("", 0)).value == put.value for k, put in puts.items() if put)
        self._line(number=number, ended=time.monotonic(), done=done)
        self._saw(seen, found)
        return found


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
