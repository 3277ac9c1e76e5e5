# SPDX-License-Identifier: Apache-2.0
"""The boards of a fleet, for the pages."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from cm.errors import CmError
from cm.networks.fleet.aio import Fleet
from cm.networks.fleet.status_text import note, stands_apart, wanted
from cm.networks.fleet.store import StoreAway, StoreRefused
from cm.web.topics import Topics
from cm.wire.messages.fleet import BoardStatus
from cm.wire.messages.status import Status

_RECONNECT = 2.0  # seconds between two tries to reach the fleet
_PAUSE = 0.25  # seconds between two tables
_SHOWN = 500  # boards at most; the page is told how many there are


class FleetWatch:
    """Follows a fleet, and tells pages a table of its boards: the topic ``fleet``."""

    def __init__(self, connect: Callable[[], Fleet], topics: Topics, say: Callable[[str], None]) -> None:
        """`say` is told in words, once each, why the fleet is not reached, and that it is."""
        self._connect = connect
        self._topics = topics
        self._say, self._wrong = say, ""
        self._rows: dict[str, dict[str, Any]] = {}
        self._statuses: dict[str, BoardStatus] = {}

    async def run(self) -> None:
        """Until it is cancelled."""
        self._tell("not connected yet")
        while True:
            try:
                async with self._connect() as fleet:
                    await self._follow(fleet)
            except (CmError, OSError) as error:
                self._tell(str(error))
                if self._wrong != (wrong := f"{error} (the page waits for it)"):
                    self._say(wrong)
                    self._wrong = wrong
            await asyncio.sleep(_RECONNECT)

    async def _follow(self, fleet: Fleet) -> None:
        self._rows, self._statuses = {}, {}
        self._tell("")
        if self._wrong:
            self._say("the fleet is there")
            self._wrong = ""
        teller = asyncio.create_task(self._tell_on())
        try:
            async with fleet.watch() as statuses:
                for name in await self._listed(fleet):  # those of the inventory that are away from the beginning
                    self._rows.setdefault(name, {**row(name, BoardStatus(Status())), "state": "gone"})
                async for name, status in statuses:
                    self._take(name, status)
        finally:
            teller.cancel()
            await asyncio.gather(teller, return_exceptions=True)

    async def _listed(self, fleet: Fleet) -> tuple[str, ...]:
        try:
            return tuple(await fleet.inventory())
        except (StoreAway, StoreRefused):  # each board says so
            return ()

    def _take(self, name: str, status: BoardStatus | None) -> None:
        if status is None:
            self._statuses.pop(name, None)
            last = self._rows.get(name, row(name, BoardStatus(Status())))
            since = f"since {time.strftime('%H:%M:%S')}; what it had loaded then is shown"
            self._rows[name] = {**last, "state": "gone", "note": since, "differs": False}
        else:
            self._statuses[name] = status
            self._rows[name] = row(name, status)

    async def _tell_on(self) -> None:
        while True:
            await asyncio.sleep(_PAUSE)
            self._tell("")

    def _tell(self, problem: str) -> None:
        shown = [self._rows[name] for name in sorted(self._rows)[:_SHOWN]]
        self._topics.tell("fleet", {"boards": shown, "count": len(self._rows), "problem": problem})


def row(name: str, status: BoardStatus) -> dict[str, Any]:
    """A board as the page shows it."""
    own = status.status
    why = note(name, status) or (own.last_error.message if own.last_error else "")
    return {
        "name": name,
        "loaded": f"{own.config_name} / {own.mode}" if own.mode else "",
        "state": own.pr_mode.value,
        "fraction": own.progress.fraction if own.progress else None,
        "labels": list(status.labels),
        "wanted": wanted(status.fleet).replace("/", " / "),
        "note": why,
        "differs": stands_apart(status),
    }
