# SPDX-License-Identifier: Apache-2.0
"""A fleet without processes: the shipped code of boards, coordinators and keeper over a random simulated network.

Every call that leaves a process waits its turn; a seeded scheduler takes one at a time, and in between lets time pass,
kills boards and coordinators, takes the store away, loses and repeats messages. A board's disk is bytes, as a real one.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import itertools
import json
import random
import weakref
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping, Sequence
from typing import Any

from cm.errors import Busy, CmError
from cm.networks.fleet.bridge.notes_file import packed, unpacked
from cm.networks.fleet.coordinator import LEASE, Coordinator, Course
from cm.networks.fleet.keeper import Ledger
from cm.networks.fleet.reconciling_board import Board, Notes, NotUndone, Part, Place, Planned, Seen, Unsettled
from cm.networks.fleet.store import Entry, Put, StoreAway, StoreRefused, View, views
from cm.wire.messages.fleet import FleetState, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo

SILENT = ErrorInfo("no_answer", "it said nothing")
HOLD = 15.0  # seconds of a manager's lease
HOME: Place = ("camera", "default")


class LoadFailed(CmError):
    code = "load_failed"


class Violation(AssertionError):
    """What must never happen."""


class SimStore:
    """The keeper's ledger behind the network, for one process."""

    def __init__(self, world: World, lossy: bool = True, whose: str = "board") -> None:
        self.world, self.lossy, self.whose = world, lossy, whose

    async def _asked(self, work: Callable[[Ledger], Any]) -> Any:
        world = self.world
        await world.turn()
        if world.slow and self.whose == "coordinator":
            await world.sleep(world.slow)
        if world.store_down or (self.lossy and world.lost()):
            raise StoreAway("the store is away")
        world.ledger.expire()
        world.asked += self.whose in world.troubled
        trouble = world.trouble if world.asked == world.trouble_at and self.whose in world.troubled else ""
        if trouble == "refused":
            raise StoreRefused("the disk is full")
        answer = work(world.ledger)
        if trouble == "lost":
            raise StoreAway("the answer was lost")
        if trouble == "asked again":  # as etcd's next member is, where the answer was lost
            answer = work(world.ledger)
        if self.lossy and world.lossy and world.chance.random() < 0.03:
            world.later(work)  # delivered once more
        await world.turn()
        if self.lossy and world.lost():
            raise StoreAway("the answer was lost")
        return answer

    async def get(self, prefix: str) -> dict[str, Entry]:
        found: dict[str, Entry] = await self._asked(lambda ledger: ledger.get(prefix))
        return found

    async def txn(self, expect: Mapping[str, int], puts: Mapping[str, Put | None]) -> int:
        def work(ledger: Ledger) -> int:
            revision = ledger.txn(expect, puts)
            if revision:
                self.world.wanted(puts)
            return revision

        return int(await self._asked(work))

    async def join(self, board: str, settings: str) -> None: ...

    async def claim(
        self, expect: Mapping[str, int], puts: Mapping[str, Put | None], lease: str, seconds: int
    ) -> dict[str, Entry]:
        found: dict[str, Entry] = await self._asked(lambda ledger: ledger.claim(expect, puts, lease, seconds))
        return found

    async def keep(self, lease: str) -> bool:
        return bool(await self._asked(lambda ledger: ledger.keep(lease)))

    async def revoke(self, lease: str) -> None:
        await self._asked(lambda ledger: ledger.revoke(lease))

    async def watch(self, prefix: str) -> AsyncIterator[dict[str, Entry]]:
        yield {}

    def now(self) -> float:
        return self.world.now

    async def close(self) -> None: ...


class SimBoard:
    """A bridge with its manager, which outlives it: modes, one register for each, a lock, a way back."""

    def __init__(self, world: World, name: str) -> None:
        self.world, self.name = world, name
        self.place, self.register = HOME, 7
        self.told = [Seen(HOME, 1)]  # what its manager said; what it said last may still be on its way
        self.way_back: tuple[str, Place, int] | None = None
        self.held_until, self.instance = 0.0, 1
        self.failing, self.breaking, self.away, self.gone = False, False, 0.0, False
        self.full = False  # its disk
        self.by_hand = False  # somebody took it elsewhere, and nothing was wanted since
        self.at = self.taken = 0.0  # when its last change ended, and when somebody took it elsewhere last
        self.disk = b""
        self.tasks: set[asyncio.Task[Any]] = set()
        self._begin()

    def _begin(self) -> None:
        store, world = SimStore(self.world), self.world
        self.board = Board(self.name, store, self, self, lambda: world.now, sleep=world.sleep)

    def start(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)
        return task

    async def hear(self, changes: Mapping[str, Entry]) -> None:
        await self.world.turn()
        self.board.told(changes)
        if self.board.wake.is_set():
            await self.board.look()

    def kill(self) -> None:
        """The bridge; it is there again at once."""
        for task in self.tasks:
            task.cancel()
        self._begin()

    def lose_power(self) -> None:
        """All of it: the hardware begins at home, and its way back is gone."""
        self.kill()
        self.place, self.register, self.way_back, self.held_until = HOME, 7, None, 0.0
        self.instance += 1
        self.by_hand = False

    def operate(self, place: Place) -> None:
        """Somebody takes it elsewhere, if nothing keeps them off."""
        if self.world.now >= self.held_until and place != self.place:
            self.place, self.register, self.way_back, self.by_hand = place, 3, None, True
            self.at = self.taken = self.world.now

    # ---- the disk -------------------------------------------------------------------------

    def read(self) -> Notes:
        return unpacked(self.disk) if self.disk else Notes()

    def write(self, notes: Notes) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "no space left")
        before = self.read()
        self.disk = packed(notes)
        part = before.part
        if part is not None and notes.part is None and notes.reached == part.generation and self.place == part.goal:
            self.by_hand = False  # it may have been taken elsewhere as its lock was given back
        self.world.reached(self.name, notes)

    # ---- the manager ----------------------------------------------------------------------

    async def where(self, known: Seen | None = None) -> Seen:
        now = Seen(self.place, self.instance, self.at)
        if now != self.told[-1]:
            self.told.append(now)
        if known is not None and known in self.told[-2:] and self.world.chance.random() < (known == now or 0.2):
            return known
        await self.world.turn()
        return Seen(self.place, self.instance, self.at)

    async def plan(self, step: FleetStep, caller: str) -> Planned:
        await self.world.turn()
        return Planned((step.config_name or self.place[0], step.mode), 0.1, 100)

    async def hold(self, part: Part) -> str:
        await self.world.turn()
        self.held_until = self.world.now + HOLD
        return part.lease or part.change

    async def release(self, part: Part) -> None:
        await self.world.turn()
        self.held_until = 0.0

    async def load(self, place: Place, caller: str, lease: str = "", undoable: str = "") -> float:
        before = (self.place, self.register)

        def done() -> None:
            self.place, self.register = place, 1
            self.way_back = (undoable, *before) if undoable else None
            if not undoable:
                self.by_hand = False

        await self._worked(done)
        return 0.1

    async def undo(self, part: Part) -> None:
        if self.way_back is None or self.way_back[0] != part.change:
            await self.world.turn()
            raise NotUndone("there is no way back")
        kept = self.way_back

        def done() -> None:
            _, self.place, self.register = kept
            self.way_back = None

        await self._worked(done, never_fails=True)

    async def _worked(self, done: Callable[[], None], never_fails: bool = False) -> None:
        await self.world.turn()
        chance = self.world.chance
        if self.failing and (self.breaking or not never_fails):
            if self.breaking:  # neither a load nor the way back from it works
                self.place, self.register, self.way_back, self.at = (self.place[0], ""), 0, None, self.world.now
            raise LoadFailed("the bitstream did not start")
        away = chance.random() < self.away
        if not away or chance.random() < 0.5:
            done()
            self.at = self.world.now
        if away:
            raise Unsettled("the manager went away")
        await self.world.turn()


class World:
    """Boards ``b0``…, a store, and whoever changes them."""

    def __init__(self, seed: int | str, size: int) -> None:
        self.chance = random.Random(seed)
        self.now, self.lossy, self.store_down = 0.0, True, False
        self.asked = 0  # requests of those in trouble that reached the store, of which one may end badly
        self.trouble, self.trouble_at, self.troubled = "", 0, ("board", "coordinator")  # refused, lost, asked again
        self.slow = 0.0  # seconds that a request of a coordinator takes to the store
        self.waiting: list[asyncio.Future[None]] = []
        self.sleeping: list[tuple[float, asyncio.Future[None]]] = []
        self.again: list[Callable[[Ledger], Any]] = []
        self.ledger = Ledger(":memory:", self.tell, lambda: self.now)
        weakref.finalize(self, self.ledger.close)
        self.history: dict[tuple[int, str], Place] = {}  # what was wanted, by generation and board
        self.told: list[Course] = []
        self.numbers = itertools.count()  # of changes
        self.known: dict[str, Mapping[str, Entry]] = {}  # what each client's last change left in the store
        self.boards = {f"b{n}": SimBoard(self, f"b{n}") for n in range(size)}

    # ---- what must hold at every moment -----------------------------------------------------

    def wanted(self, puts: Mapping[str, Put | None]) -> None:
        for name, put in puts.items():
            if put is not None and name.endswith("/wanted"):
                plain = json.loads(put.value)
                where = (plain["generation"], name.split("/")[1])
                place = (plain["config"], plain["mode"])
                if where[0] <= max((g for g, board in self.history if board == where[1]), default=0):
                    raise Violation(f"generation {where[0]} is wanted of {where[1]} after a newer one")
                if self.history.setdefault(where, place) != place:
                    raise Violation(f"two views of generation {where[0]} for {where[1]}")

    def reached(self, name: str, notes: Notes) -> None:
        newest = max((g for g, board in self.history if board == name), default=0)
        if notes.reached > newest:
            raise Violation(f"{name} reached generation {notes.reached}, of which nothing was wanted")

    # ---- the network ------------------------------------------------------------------------

    async def turn(self) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.waiting.append(future)
        await future

    async def sleep(self, seconds: float) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.sleeping.append((self.now + seconds, future))
        await future

    def tell(self, changes: Mapping[str, Entry]) -> None:
        """The store's watches: late, in any order, or not at all."""
        for name, board in self.boards.items():
            own = {k: entry for k, entry in changes.items() if k.startswith(f"boards/{name}/")}
            if own and not board.gone and not self.lost():
                board.start(board.hear(own))

    def lost(self) -> bool:
        return self.lossy and self.chance.random() < 0.02

    def later(self, work: Callable[[Ledger], Any]) -> None:
        self.again.append(work)

    async def ask(
        self, boards: Sequence[str], verb: str, step: FleetStep, caller: str
    ) -> AsyncIterator[tuple[str, FleetState | ErrorInfo]]:
        carried = [asyncio.ensure_future(self._carried(board, verb, step, caller)) for board in boards]
        for each in asyncio.as_completed(carried):
            yield await each

    async def _carried(self, board: str, verb: str, step: FleetStep, caller: str) -> tuple[str, FleetState | ErrorInfo]:
        """As the network carries it: late, twice, or not at all."""
        await self.turn()
        if self.lost():
            return board, SILENT
        answer = await self._delivered(board, verb, step, caller)
        if self.lossy and self.chance.random() < 0.03:
            self.boards[board].start(self._delivered(board, verb, step, caller))
        await self.turn()
        return board, SILENT if self.lost() else answer

    async def _delivered(self, board: str, verb: str, step: FleetStep, caller: str) -> FleetState | ErrorInfo:
        there = self.boards[board]
        if there.gone:
            return SILENT
        work = there.start(there.board.step(verb, step, caller))
        await asyncio.wait([work])
        if work.cancelled():
            return SILENT
        error = work.exception()
        if isinstance(error, (CmError, OSError)):
            return ErrorInfo(getattr(error, "code", "io"), str(error))
        found: FleetState = work.result()
        return found

    async def change(
        self, caller: str, goal: Place, members: Sequence[str], policy: Policy, away: Sequence[str] = ()
    ) -> Course | None:
        store = SimStore(self, whose="coordinator")
        coordinator = Coordinator(
            store, lambda *asked: self.ask(*asked, caller), caller, f"{caller}-{next(self.numbers)}",
            lambda _: (sorted(members), dict.fromkeys(away, SILENT)), *goal, policy,
            clock=lambda: self.now, sleep=self.sleep,
        )  # fmt: skip
        coordinator.known, self.known[caller] = self.known.get(caller, {}), {}
        try:
            course = await coordinator.run()
        except (Busy, StoreAway, StoreRefused):
            return None
        self.known[caller] = coordinator.known
        self.told.append(course)
        return course

    # ---- time and chance ----------------------------------------------------------------------

    async def go_on(self) -> bool:
        """Take one turn, or let the time come for which somebody waits; False if nobody waits for anything."""
        if self.again and self.chance.random() < 0.2:
            work = self.again.pop(self.chance.randrange(len(self.again)))
            with contextlib.suppress(CmError):
                work(self.ledger)
        self.waiting = [future for future in self.waiting if not future.done()]
        self.sleeping = [each for each in self.sleeping if not each[1].done()]
        if self.waiting:
            self.waiting.pop(self.chance.randrange(len(self.waiting))).set_result(None)
            self.now += 0.001
        elif self.sleeping:
            self.now = max(self.now, min(end for end, _ in self.sleeping))
        for end, future in self.sleeping:
            if end <= self.now and not future.done():
                future.set_result(None)
        for _ in range(8):  # until the tasks wait again
            await asyncio.sleep(0)
        return bool(self.waiting or self.sleeping)

    def beat(self, name: str) -> None:
        """The bridge looks, as it does each second or when something has changed."""
        board = self.boards[name]
        if not board.gone:
            board.start(board.board.look())

    async def run(self, *work: asyncio.Task[Any], meanwhile: Callable[[], None] = lambda: None) -> None:
        for _ in range(6000):
            if all(task.done() for task in work):
                return
            meanwhile()
            if not await self.go_on():
                self.now += 0.1
        raise Violation("it never ends")

    async def heal(self, seconds: float = LEASE + 5.0) -> None:
        """Let that much time pass without further faults; the boards look each second."""
        self.lossy, self.store_down = False, False
        self.again.clear()
        for board in self.boards.values():
            board.away, board.gone, board.failing, board.full = 0.0, False, False, False
        end = self.now + seconds
        while self.now < end:
            for name in self.chance.sample(sorted(self.boards), len(self.boards)):
                self.beat(name)
            await self.run(*(task for board in self.boards.values() for task in board.tasks))
            self.now += 1.0

    # ---- what must hold at the end --------------------------------------------------------------

    def view(self, name: str) -> View:
        return views(self.ledger.get(f"boards/{name}/")).get(name, View())

    def judge(self) -> None:
        """No part, lock or claim is left; each board is where it is wanted, unless somebody took it elsewhere."""
        self.ledger.expire()
        for name, board in self.boards.items():
            notes, view = board.read(), self.view(name)
            if notes.part is not None or view.open is not None:
                raise Violation(f"{name}: undecided after the lease and 5 s: {notes.part} {view.open}")
            if self.now < board.held_until:
                raise Violation(f"{name} is still locked")
            if view.wanted is None:
                continue
            place = (view.wanted.config, view.wanted.mode)
            if notes.reached != view.generation:
                raise Violation(f"{name}: reached {notes.reached}, wanted {view.generation}")
            if board.place != place and not (board.by_hand and board.taken >= view.wanted.at):
                raise Violation(f"{name}: is {board.place}, wanted {place}, and nobody took it there")
        for course in self.told:
            kept = any(generation == course.generation for generation, _ in self.history)
            if course.decision is not None and (course.decision.value == "keep") != kept:
                raise Violation(f"{course.id} was told {course.decision}, the store has {kept}")


async def killed(task: asyncio.Task[Any], world: World) -> None:
    """Kill a coordinator, wherever it is: it cleans nothing up, since the store hears nothing from it any more."""
    down, world.store_down = world.store_down, True
    task.cancel()
    while not task.done():
        await world.go_on()
    world.store_down = down
