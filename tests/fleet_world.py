# SPDX-License-Identifier: Apache-2.0
"""A fleet without processes: the shipped code of boards and clients over a random simulated network.

Every call that leaves a process waits its turn; a seeded scheduler takes one at a time, and in between lets time
pass, kills boards and clients, loses and repeats messages. A board's disk is bytes, as on a real one.
"""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import Coroutine, Sequence
from typing import Any

from cm.errors import CmError
from cm.networks.fleet import names
from cm.networks.fleet.bridge.commands import Commands
from cm.networks.fleet.change.asks import Ask
from cm.networks.fleet.change.coordinator import Outcome, first_step
from cm.networks.fleet.change.participant import Participant
from cm.networks.fleet.change.ports import Planned, Unsettled
from cm.networks.fleet.changing import Course, carried_out
from cm.networks.fleet.recovering import recovered
from cm.wire.fleet import decode_answer
from cm.wire.fleet_records import decode_record, encode_record, encode_step
from cm.wire.messages.fleet import Decision, FleetRecord, Policy
from cm.wire.messages.status import ErrorInfo

OLD, NEW = ("camera", "default"), ("camera", "edge")
CHANGE = "c1"
SILENT = ErrorInfo("no_answer", "it said nothing")


class LoadFailed(CmError):
    code = "load_failed"


class Network:
    """Where every call waits for its turn."""

    def __init__(self, chance: random.Random) -> None:
        self.chance = chance
        self.waiting: list[asyncio.Future[None]] = []
        self.lossy = True

    async def turn(self) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.waiting.append(future)
        await future

    def lost(self) -> bool:
        return self.lossy and self.chance.random() < 0.04

    async def go_on(self) -> bool:
        """Take one turn; return whether more are waiting."""
        self.waiting = [future for future in self.waiting if not future.done()]
        if self.waiting:
            self.waiting.pop(self.chance.randrange(len(self.waiting))).set_result(None)
        for _ in range(4):  # until the task waits again
            await asyncio.sleep(0)
        return bool(self.waiting)


class Disk:
    """What survives a loss of power."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.newest = ""

    def read(self, change: str) -> FleetRecord | None:
        return decode_record(self.files[change]) if change in self.files else None

    def last(self) -> FleetRecord | None:
        return self.read(self.newest)

    def write(self, record: FleetRecord) -> None:
        if record.state != "open":
            self.newest = record.id
        self.files[record.id] = encode_record(record)


class Board:
    """A bridge with its manager; the manager is not killed, but may be away during a load."""

    def __init__(self, world: World, name: str) -> None:
        self.world, self.name = world, name
        self.disk, self.place = Disk(), OLD
        self.gone = self.held = False
        self.failing, self.away = False, 0.0  # whether loads of the new mode fail; how often the manager goes away
        self.tasks: set[asyncio.Task[Any]] = set()
        self._begin()

    def _begin(self) -> None:
        participant = Participant(self.name, self.disk, self, self, lambda: self.world.now)
        self.commands = Commands(None, participant, self, None)  # type: ignore[arg-type]

    def start(self, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)
        return task

    def kill(self, for_good: bool = False) -> None:
        for task in self.tasks:
            task.cancel()
        if for_good:
            self.gone, self.disk = True, Disk()
        self._begin()

    @property
    def record(self) -> FleetRecord | None:
        return self.disk.read(CHANGE)

    # ---- the manager ----------------------------------------------------------------------

    async def where(self) -> tuple[str, str]:
        await self.world.network.turn()
        return self.place

    async def plan(self, config: str, mode: str, caller: str) -> Planned:
        await self.world.network.turn()
        return Planned(config, mode, 0.1, 100)

    async def hold(self, record: FleetRecord) -> None:
        await self.world.network.turn()
        self.held = True

    async def keep_holding(self, record: FleetRecord) -> None:
        assert self.held

    async def release(self, record: FleetRecord) -> None:
        await self.world.network.turn()
        self.held = False

    async def load(self, config: str, mode: str, caller: str) -> float:
        await self.world.network.turn()
        if self.failing and (config, mode) == NEW:
            raise LoadFailed("the bitstream did not start")
        away = self.world.chance.random() < self.away
        if not away or self.world.chance.random() < 0.5:
            self.place = (config, mode)
        if away:
            raise Unsettled("the manager went away")
        await self.world.network.turn()
        return 0.1

    # ---- the other boards -----------------------------------------------------------------

    async def ask(self, asks: Sequence[Ask]) -> dict[str, FleetRecord]:
        answers = await asyncio.gather(*(self.world.ask(ask, self.name) for ask in asks))
        found = zip(asks, answers, strict=True)
        return {ask.board: answer for ask, answer in found if isinstance(answer, FleetRecord)}


class World:
    """Boards ``b0``…, one change, and whoever asks for it or recovers it."""

    def __init__(self, seed: int, size: int, seats: tuple[str, ...] = ()) -> None:
        self.chance = random.Random(seed)
        self.network = Network(self.chance)
        self.now = 0.0
        self.boards = {f"b{n}": Board(self, f"b{n}") for n in range(size)}
        self.seats = seats
        self.said: list[Decision] = []  # the decisions that clients were told

    async def ask(self, ask: Ask, caller: str) -> FleetRecord | ErrorInfo:
        """As the network carries it: late, twice, or not at all."""
        await self.network.turn()
        if self.network.lost():
            return SILENT
        answer = await self._delivered(ask, caller)
        if self.network.lossy and self.chance.random() < 0.04:
            self.boards[ask.board].start(self._delivered(ask, caller))  # it is delivered once more, later
        await self.network.turn()
        return SILENT if self.network.lost() else answer

    async def _delivered(self, ask: Ask, caller: str) -> FleetRecord | ErrorInfo:
        board = self.boards[ask.board]
        if board.gone:
            return SILENT
        command = names.Command(ask.verb.value, caller)
        work = board.start(board.commands.do(command, encode_step(ask.step), []))
        await asyncio.wait([work])
        if work.cancelled():
            return SILENT
        found = decode_answer(work.result())
        assert isinstance(found, (FleetRecord, ErrorInfo))
        return found

    # ---- clients --------------------------------------------------------------------------

    async def change(self, policy: Policy = Policy.ALL, members: Sequence[str] = ()) -> Course:
        step = first_step(CHANGE, members or self.boards, *NEW, policy, 30.0, self.seats)
        course = await carried_out(step, lambda ask: self.ask(ask, "anna"), lambda *_: None)
        return self._told(course.outcome) and course

    async def recover(self) -> Outcome | None:
        """What another client does, from any record that it finds."""
        for board in self.boards.values():
            if not board.gone and board.disk.last() is not None:
                outcome = await recovered(board.disk.last(), lambda ask: self.ask(ask, "bob"))  # type: ignore[arg-type]
                return self._told(outcome) and outcome
        return None

    def _told(self, outcome: Outcome) -> Outcome:
        if outcome.decision is not None:
            self.said.append(outcome.decision)
        return outcome

    # ---- time and chance ------------------------------------------------------------------

    async def run(self, *work: asyncio.Task[Any], trouble: float = 0.0, lost: int = 0) -> None:
        """Until the work is done; `trouble`: how often a board is killed, at most `lost` of them for good."""
        for _ in range(3000):
            if all(task.done() for task in work):
                return
            self._meanwhile(trouble, lost)
            if not await self.network.go_on():
                self.now += 1.0
        raise AssertionError("it never ends")

    def _meanwhile(self, trouble: float, lost: int) -> None:
        if self.chance.random() < 0.05:
            self.now += self.chance.choice((1.0, 40.0))
        there = [board for board in self.boards.values() if not board.gone]
        if there and self.chance.random() < 0.1:
            board = self.chance.choice(there)
            board.start(board.commands.go_on())
        if there and self.chance.random() < trouble:
            gone = len(self.boards) - len(there)
            self.chance.choice(there).kill(for_good=gone < lost and self.chance.random() < 0.5)

    async def heal(self) -> None:
        """Let time pass without further faults: every board does what its record says."""
        self.network.lossy = False
        for board in self.boards.values():
            board.away = 0.0
            board.kill(board.gone)
        self.now += 100.0
        for _ in range(8):
            self.now += 1.0
            there = [board for board in self.boards.values() if not board.gone]
            beats: list[asyncio.Task[Any]] = []
            for board in self.chance.sample(there, len(there)):  # at some moment of the second, each
                beats.append(board.start(board.commands.go_on()))
                if self.chance.random() < 0.5:
                    await self.run(*beats)
            await self.run(*(task for board in there for task in board.tasks))

    # ---- what holds -----------------------------------------------------------------------

    def decisions(self) -> set[Decision]:
        """All decisions known to anybody: remaining boards and clients."""
        records = [board.record for board in self.boards.values() if not board.gone]
        return {r.decision for r in records if r is not None and r.decision is not None} | set(self.said)


async def ended(task: asyncio.Task[Any]) -> None:
    """Kill a task, wherever it is."""
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
