# SPDX-License-Identifier: Apache-2.0
"""A board as a participant in changes of its fleet: its part is recorded on disk, and carried out by its manager.

Both are given, so that every order of ends can be tried. Nothing is kept here between two calls but what the store
has: whoever reads it after an end goes on from there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from cm.errors import Busy, CmError, InvalidRequest
from cm.fleet.change import member
from cm.fleet.change.member import Event, NotNow, Todo
from cm.messages.fleet import Decision, FleetRecord, FleetStep, Policy
from cm.messages.status import ErrorInfo


class Unsettled(CmError):
    """What became of a load is not known yet: the manager went away, or is still at it."""

    code = "unsettled"


@dataclass(frozen=True, slots=True)
class Planned:
    """Where a change would lead, and what it would take."""

    config_name: str
    mode: str
    seconds: float
    bytes: int


class Store(Protocol):
    """Records on disk. `write` returns when a loss of power would not undo it."""

    def read(self, change: str) -> FleetRecord | None: ...
    def last(self) -> FleetRecord | None: ...
    def write(self, record: FleetRecord) -> None: ...


class Board(Protocol):
    """The manager, asked in somebody's name. All raise CmError; `load` and `where` raise Unsettled."""

    async def where(self) -> tuple[str, str]: ...
    async def plan(self, config: str, mode: str, caller: str) -> Planned: ...
    async def hold(self, record: FleetRecord) -> None: ...
    async def release(self, record: FleetRecord) -> None: ...
    async def load(self, config: str, mode: str, caller: str) -> float: ...


class Seat(Protocol):
    """The board that has the decision. None: it does not answer."""

    async def asked(self, seat: str, change: str, caller: str) -> FleetRecord | None: ...


class Clock(Protocol):
    """CLOCK_REALTIME, seconds."""

    def __call__(self) -> float: ...


class Participant:
    """One board's. The caller sees to it that no two of prepare, apply, decide and go_on run at a time."""

    def __init__(self, name: str, store: Store, board: Board, seat: Seat, now: Clock) -> None:
        self._name = name
        self._store = store
        self._board = board
        self._seat = seat
        self._now = now

    @property
    def record(self) -> FleetRecord | None:
        """Of the last change that this board took part in."""
        return self._store.last()

    # ---- what the coordinator asks for ----------------------------------------------------

    async def prepare(self, step: FleetStep, caller: str) -> FleetRecord:
        """Plan the change, which validates all its files, keep others off, and write down where the board is.

        Raises Busy for a second change, and what the manager refuses with; then nothing was touched.
        """
        known = self._store.read(step.id)
        if known is not None:
            if known.decision is not None:
                raise NotNow(f"change {step.id} was decided already: {known.decision.value}")
            return known
        self._refuse_while_another()
        old_config, old_mode = await self._board.where()
        if not old_mode and step.policy is not Policy.BEST_EFFORT:
            raise InvalidRequest(
                f"{self._name}: nothing is loaded, so there is no way back: load a configuration first, "
                "or take the policy best_effort"
            )
        planned = await self._board.plan(step.config_name, step.mode, caller)
        record = FleetRecord(
            step.id,
            member.PREPARED,
            planned.config_name,
            planned.mode,
            old_config,
            old_mode,
            step.seat,
            plan_seconds=planned.seconds,
            plan_bytes=planned.bytes,
            caller=caller,
            members=step.members,
            policy=step.policy,
            deadline=self._now() + step.seconds,
        )
        await self._board.hold(record)
        self._store.write(record)
        return record

    def _refuse_while_another(self) -> None:
        last = self._store.last()
        if last is not None and not member.ended(last):
            raise Busy(
                f"{self._name}: change {last.id} of {last.caller or 'somebody'} is {last.state} here; "
                f"it ends by itself, or asks {last.seat} what was decided"
            )

    async def apply(self, step: FleetStep) -> FleetRecord:
        """Go to the new mode; the answer says whether the board is there. Raises NotNow."""
        record = self._known(step.id)
        before = record.state
        record = replace(member.after(record, Event.APPLY), deadline=self._now() + step.seconds)
        self._store.write(record)
        return await self._work(record, begun=before == member.PREPARED)

    async def decide(self, step: FleetStep) -> FleetRecord:
        """What was decided, to be written down and done; at the seat, the decision itself."""
        record = self._store.read(step.id)
        if record is None:
            if step.seat != self._name:
                raise NotNow(f"{self._name} took no part in change {step.id}")
            record = FleetRecord(step.id, member.OPEN, seat=self._name)
        before = record.state
        record = member.decided(record, Decision.KEEP if step.keep else Decision.REVERT)
        self._store.write(record)
        return await self._work(record, begun=before not in (member.APPLYING, member.REVERTING))

    def settle(self, change: str) -> FleetRecord:
        """As the seat: what was decided, for a board that was not told. It never waits."""
        known = self._store.read(change)
        record = member.asked_at_the_seat(known, change, self._now())
        if record != known:
            self._store.write(record)
        return record

    def _known(self, change: str) -> FleetRecord:
        record = self._store.read(change)
        if record is None:
            raise NotNow(f"{self._name} has prepared no change {change}")
        return record

    # ---- what it does by itself -----------------------------------------------------------

    async def go_on(self) -> None:
        """At the start, and from time to time: whatever the record says is to be done. Raises Unsettled."""
        record = self._store.last()
        if record is None:
            return
        if member.ended(record):  # as the seat it may have ended without waiting, or somebody before us was killed
            await self._board.release(record)
            return
        if member.todo(record, self._now()) is Todo.ASK_SEAT:
            record = await self._ask_seat(record)
        await self._work(record, begun=False)

    async def _ask_seat(self, record: FleetRecord) -> FleetRecord:
        if record.seat == self._name:
            return self.settle(record.id)
        said = await self._seat.asked(record.seat, record.id, record.caller)
        if said is None or said.decision is None:
            return record
        return self._changed(record.id, decision=said.decision)

    async def _work(self, record: FleetRecord, begun: bool) -> FleetRecord:
        """Load as long as the record wants it. `begun`: no load can have been asked for before."""
        while True:
            step = member.todo(record, 0.0)
            if step is Todo.NOTHING:
                break
            record = await self._load(record, new=step is Todo.LOAD_NEW, begun=begun)
            begun = True
        if member.ended(record):
            await self._board.release(record)
        return record

    async def _load(self, record: FleetRecord, new: bool, begun: bool) -> FleetRecord:
        goal = (record.config_name, record.mode) if new else (record.old_config_name, record.old_mode)
        if not begun:  # somebody before us was at it
            if await self._board.where() == goal:
                return self._changed(record.id, Event.LOADED)
            record = self._changed(record.id, Event.LOST)
            if record.state not in (member.APPLYING, member.REVERTING):
                return record
        try:
            await self._board.hold(record)
            seconds = await self._board.load(*goal, record.caller)
        except Unsettled:
            raise
        except CmError as error:
            return self._changed(record.id, Event.LOAD_FAILED, ErrorInfo(error.code, str(error)))
        return self._changed(record.id, Event.LOADED, seconds=seconds if new else 0.0)

    def _changed(
        self,
        change: str,
        event: Event | None = None,
        error: ErrorInfo | None = None,
        seconds: float = 0.0,
        decision: Decision | None = None,
    ) -> FleetRecord:
        """The record as it is by now, with what has happened: the seat may have decided meanwhile."""
        record = self._known(change)
        if decision is not None:
            record = member.decided(record, decision)
        if event is not None:
            record = member.after(record, event, error, seconds)
        self._store.write(record)
        return record
