# SPDX-License-Identifier: Apache-2.0
"""What can be read from a fleet: its boards, and what each says."""

from __future__ import annotations

import asyncio
import fnmatch
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager
from time import time_ns
from typing import Any

from cm.networks.fleet import asking, names
from cm.networks.fleet.asking import Answer, Told, absent
from cm.networks.fleet.clocks import Reading, reading
from cm.networks.fleet.errors import NoSuchBoard
from cm.networks.fleet.presence import Presence
from cm.networks.fleet.store import BOARDS, Store, StoreAway, StoreRefused, View, views
from cm.wire import fleet as wire
from cm.wire.encode import decode_plan, decode_registers
from cm.wire.messages.fleet import BoardStatus
from cm.wire.messages.status import ErrorInfo, PlanInfo, RegValues

ALL = ("*",)


class Looker:
    """Boards, by name, glob (``line1-*``) or label (``@camera``); all if none is named."""

    session: Any
    _store: Store
    _presence: Presence
    timeout: float  # seconds

    # ---- who is there -----------------------------------------------------------------------

    async def boards(self) -> tuple[str, ...]:
        """Names of all boards whose bridges are running, sorted."""
        return self._presence.boards()

    async def inventory(self) -> dict[str, View]:
        """The boards of the fleet, there or away, sorted: each with its settings and with what is wanted of it.

        Raises StoreAway.
        """
        found = views(await self._store.get(BOARDS))
        return {name: view for name, view in found.items() if view.settings is not None}

    async def chosen(self, boards: Iterable[str] = ALL, exist: bool = True) -> tuple[str, ...]:
        """The boards of a group, sorted, from the inventory. Raises NoSuchBoard for a part of it that matches none.

        `exist`: False: also those that are there and not in the inventory, and any that are given by name.
        """
        groups, known = tuple(boards) or ALL, await self.inventory()
        there = set(known) if exist else {*known, *await self.boards()}
        found: set[str] = set()
        for group in groups:
            if group.startswith("@"):
                members = {n for n, view in known.items() if view.settings and group[1:] in view.settings.labels}
            else:
                members = set(fnmatch.filter(there, group)) or ({group} if not exist and _is_name(group) else set())
            if not members:
                loose = ", ".join(sorted({*await self.boards()} - {*known}))
                raise NoSuchBoard(
                    f"no board of the inventory is called or labelled {group}; it has {', '.join(known) or 'none'}"
                    + (f" (there, but not in it: {loose}; `cm fleet add` puts them in)" if loose else "")
                )
            found |= members
        return tuple(sorted(found))

    async def meant(self, boards: Iterable[str]) -> tuple[str, ...]:
        """The boards of a group for what is no change: of names, those; of none, all that are there, store or not."""
        groups = tuple(boards) or ALL
        if groups == ALL:
            return await self.boards()
        return tuple(sorted(groups)) if all(map(_is_name, groups)) else await self.chosen(groups)

    # ---- looking ------------------------------------------------------------------------------

    async def status(self, boards: Iterable[str] = ALL) -> dict[str, BoardStatus | ErrorInfo]:
        """The status of each board, or why there is none (code ``no_answer``, or what its manager said).

        By default of all that are there or in the inventory; if the store is away, of those that are there. Raises
        NoSuchBoard for a glob or a label that matches none; a name that does not exist gets an error.
        """
        found = await self._each("status", boards)
        if tuple(boards) in ((), ALL):
            try:
                away = set(await self.inventory()) - set(found)
            except (StoreAway, StoreRefused):
                away = set()
            found = dict(sorted({**{n: Answer(n, "", b"", error=absent(False)) for n in away}, **found}.items()))
        return {n: a.error or wire.board_status(a.payload) for n, a in found.items()}

    async def plan(
        self, mode: str = "", config: str = "", boards: Iterable[str] = ALL
    ) -> dict[str, PlanInfo | ErrorInfo]:
        """What a change would do on each board, in steps, bytes and seconds; touches nothing.

        Without `mode` to the default mode, without `config` of the loaded configuration. Raises NoSuchBoard.
        """
        words = f"config?plan={mode}" + (f";config={config}" if config else "")
        found = await self._each(words, boards, max(self.timeout, 30.0))
        return {n: a.error or decode_plan(a.payload) for n, a in found.items()}

    async def read(self, register: str, boards: Iterable[str] = ALL) -> dict[str, RegValues | ErrorInfo]:
        """A register, or ``register.field``, of each board. Raises NoSuchBoard, InvalidRequest (a name with ``/``)."""
        found = await self._each(f"reg/{names.check(register, 'register')}", boards)
        return {n: a.error or decode_registers(a.payload) for n, a in found.items()}

    async def clocks(self, boards: Iterable[str] = ALL) -> dict[str, Reading | ErrorInfo]:
        """How far each board's clock may be off, ns: as it says itself, and the bounds measured from here.

        Raises NoSuchBoard.
        """
        chosen = await self.meant(boards)
        found = await asyncio.gather(*(self._clock(name) for name in chosen))
        return dict(zip(chosen, found, strict=True))

    async def _clock(self, board: str) -> Reading | ErrorInfo:
        """The least delayed of a few readings: it bounds the offset best."""
        best: Reading | ErrorInfo = absent(True)
        for _ in range(4):
            answer, asked, came = await self._timed(board)
            if answer.error is None:
                found = reading(wire.board_status(answer.payload).clock, asked, came)
                best = found if isinstance(best, ErrorInfo) or found.width_ns < best.width_ns else best
        return best

    async def _timed(self, board: str) -> tuple[Answer, int, int]:
        asked = time_ns()
        answer = (await self._each("status", (board,)))[board]
        return answer, asked, time_ns()

    @asynccontextmanager
    async def watch(self, boards: str = "*") -> AsyncIterator[AsyncIterator[tuple[str, BoardStatus | None]]]:
        """Statuses of boards as they change, and each second; None when a board has gone. One name or ``*``."""
        async with asking.listening(self.session, names.key(boards, "status"), self._presence) as told:
            yield self._statuses(told)

    async def _statuses(self, told: AsyncIterator[Told]) -> AsyncIterator[tuple[str, BoardStatus | None]]:
        async for each in told:
            if each.payload is None:
                yield each.board, None
            elif each.key.endswith("/status"):
                yield each.board, wire.board_status(each.payload)

    @asynccontextmanager
    async def listen(self, board: str, *parts: str) -> AsyncIterator[AsyncIterator[Told]]:
        """What a board publishes: ``listen("b1", "frames", "camera")``, ``listen("*", "irq", "*")``.

        If more than 64 wait to be read, the oldest are lost.
        """
        async with asking.listening(self.session, names.key(board, *parts), waiting=64) as told:
            yield told

    async def _each(self, rest: str, boards: Iterable[str], timeout: float = 0.0) -> dict[str, Answer]:
        """An answer for each board; one that is absent or does not answer gets an error that says so."""
        limit, groups = timeout or self.timeout, tuple(boards) or ALL
        if groups != ALL:
            chosen = groups if all(map(_is_name, groups)) else await self.chosen(groups)
            return await self._each_by_name(rest, chosen, limit)
        asked = asking.get(self.session, names.key("*", rest), timeout=limit)
        answers, there = await asyncio.gather(asked, self.boards())
        found = {answer.board: answer for answer in answers}
        # Rules match by inclusion: a caller that may query some boards but not all gets nothing at all for "*".
        left = await self._each_by_name(rest, tuple(name for name in there if name not in found), limit)
        return dict(sorted({**found, **left}.items()))

    async def _each_by_name(self, rest: str, boards: tuple[str, ...], limit: float) -> dict[str, Answer]:
        found = await asyncio.gather(*(asking.get(self.session, names.key(n, rest), timeout=limit) for n in boards))
        there = await self.boards() if not all(found) else boards
        return {
            name: answers[0] if answers else Answer(name, "", b"", error=absent(name in there))
            for name, answers in zip(boards, found, strict=True)
        }


def _is_name(group: str) -> bool:
    return not group.startswith("@") and not names.WILD & set(group) and "[" not in group
