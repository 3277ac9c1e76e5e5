# SPDX-License-Identifier: Apache-2.0
"""Where a fleet's wanted state lies: what a store has to offer, and what is kept in it under which key.

A store is one sequence of transactions. All keys and values are text; `revision` numbers the transactions.

    generation              number of the newest change that was opened
    boards/<name>/settings  the board is in the inventory: its labels
    boards/<name>/wanted    where it is to be, and since which generation
    boards/<name>/claim     the change that is open here; lies under its coordinator's lease, and vanishes with it
"""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

from cm.errors import CmError, InvalidRequest

GENERATION, BOARDS = "generation", "boards/"


class StoreAway(CmError, ConnectionError):
    """The store does not answer. What was asked of it may have been done, or may still be."""

    code = "store_away"


class StoreRefused(CmError):
    """The store refuses a request: rights, its own limits."""

    code = "store_refused"


class Entry(NamedTuple):
    """A value, and the revision of the transaction that put it; where changes are told, "" is one that was deleted."""

    value: str
    revision: int


class Put(NamedTuple):
    """A value to put; with a lease it vanishes when that ends."""

    value: str
    lease: str = ""


Expect = Mapping[str, int]  # the revision that each key is to have; 0: it is absent
Puts = Mapping[str, Put | None]  # None: delete it


class Store(Protocol):
    """All calls raise StoreAway and StoreRefused; what `get` returns is the newest there is, not a copy's."""

    async def get(self, prefix: str) -> dict[str, Entry]:
        """All keys that begin so."""

    async def txn(self, expect: Expect, puts: Puts) -> int:
        """If all is as expected, put all. Its revision; 0: nothing was done."""

    async def join(self, board: str, settings: str) -> None:
        """Put a board's own settings: all that a board may write."""

    async def claim(self, expect: Expect, puts: Puts, lease: str, seconds: int) -> dict[str, Entry]:
        """As `txn`, with a lease, a number that nobody else has, by the store's clock. All that there is then."""

    async def keep(self, lease: str) -> bool:
        """Renew it; False if it has ended."""

    async def revoke(self, lease: str) -> None:
        """End it, and with it the keys under it."""

    def watch(self, prefix: str) -> AsyncIterator[dict[str, Entry]]:
        """What has changed under a prefix; nothing at the beginning and after every gap: then it is to be read."""

    def now(self) -> float:
        """Seconds by the store's own clock, as its last answer told it: the same for all who ask."""

    async def close(self) -> None:
        """Disconnect."""


# ---- what lies in it ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Settings:
    """Of a board of the inventory."""

    labels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Wanted:
    """Where a board is to be, since which generation, and in whose name; `at`: when, by the store's clock."""

    generation: int
    config: str
    mode: str
    by: str
    change: str
    at: float = 0.0

    @property
    def place(self) -> tuple[str, str]:
        """Configuration and mode."""
        return self.config, self.mode


@dataclass(frozen=True, slots=True)
class Claim:
    """The change that is open on a board."""

    generation: int
    change: str
    by: str


@dataclass(frozen=True, slots=True)
class View:
    """A board as the store has it; `revisions` by the last part of its keys."""

    settings: Settings | None = None
    wanted: Wanted | None = None
    claim: Claim | None = None
    revisions: Mapping[str, int] | None = None

    @property
    def generation(self) -> int:
        """Since when it is wanted where it is; 0: nobody ever wanted anything."""
        return self.wanted.generation if self.wanted else 0

    @property
    def open(self) -> Claim | None:
        """The change that is not decided here: one whose generation is wanted already is."""
        return self.claim if self.claim and self.claim.generation > self.generation else None

    def revision(self, part: str) -> int:
        """What a transaction compares that must find that part as it is here."""
        return (self.revisions or {}).get(part, 0)


_KINDS: dict[str, Any] = {"settings": Settings, "wanted": Wanted, "claim": Claim}


def key(board: str, part: str) -> str:
    """Of one of a board's three values."""
    return f"{BOARDS}{board}/{part}"


def packed(value: Settings | Wanted | Claim) -> str:
    """As it lies in the store."""
    return json.dumps(asdict(value), separators=(",", ":"))


def views(found: Mapping[str, Entry]) -> dict[str, View]:
    """Boards by name. Raises InvalidRequest for what no version of this program wrote."""
    parts: dict[str, dict[str, Any]] = {}
    revisions: dict[str, dict[str, int]] = {}
    for name, entry in found.items():
        _, board, part = name.split("/") if name.startswith(BOARDS) else ("", "", "")
        if part in _KINDS:
            try:
                parts.setdefault(board, {})[part] = _read(part, entry.value)
            except (ValueError, TypeError, KeyError) as error:
                raise InvalidRequest(f"the store has {entry.value[:60]!r} under {name}: {error}") from None
            revisions.setdefault(board, {})[part] = entry.revision
    return {board: View(revisions=revisions[board], **values) for board, values in sorted(parts.items())}


@lru_cache(256)  # a change puts the same on all of its boards, and what a board is told of has two parts that stay
def _read(part: str, text: str) -> Settings | Wanted | Claim:
    plain = json.loads(text)
    made = _KINDS[part](**{field: plain[field] for field in _KINDS[part].__slots__ if field in plain})
    return Settings(tuple(made.labels)) if part == "settings" else made
