# SPDX-License-Identifier: Apache-2.0
"""A board's part in changes of its fleet: it keeps records on one side, and drives the manager on the other.

Both are passed in, so that a crash at every point can be tested. All state between two calls is in the store: the next
process continues from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from cm.errors import Busy, CmError, InvalidRequest
from cm.networks.fleet.change import member, seats
from cm.networks.fleet.change.asks import Ask, Verb
from cm.networks.fleet.change.member import Event, NotNow, Todo
from cm.networks.fleet.change.ports import Others, OwnBoard, Store, Unsettled, WallClock
from cm.wire.messages.fleet import Decision, FleetRecord, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo


class Participant:
    """One board's part. The caller ensures that no two of prepare, apply, decide and go_on run at a time."""

    def __init__(self, name: str, store: Store, board: OwnBoard, others: Others, now: WallClock) -> None:
        self._name = name
        self._store = store
        self._board = board
        self._others = others
        self._now = now

    @property
    def record(self) -> FleetRecord | None:
        """The record of the last change that this board took part in."""
        return self._store.last()

    # ---- what the coordinator asks for ----------------------------------------------------

    async def prepare(self, step: FleetStep, caller: str) -> FleetRecord:
        """Plan the change, which validates all its files, take a lease, and record where the board is.

        Raises Busy for a second change, and the manager's refusal; then nothing was touched.
        """
        known = self._given_up(step.id)
        if known is not None:
            return known
        self._refuse_while_another()
        old_config, old_mode = await self._board.where()
        if not old_mode and step.policy is not Policy.BEST_EFFORT:
            raise InvalidRequest(
                "nothing is loaded, so there is no way back: load a configuration first, or take the policy best-effort"
            )
        planned = await self._board.plan(step.config_name, step.mode, caller)
        record = FleetRecord(
            step.id,
            member.PREPARED,
            planned.config_name,
            planned.mode,
            old_config,
            old_mode,
            step.seats,
            plan_seconds=planned.seconds,
            plan_bytes=planned.bytes,
            caller=caller,
            members=step.members,
            policy=step.policy,
            deadline=self._deadline(step),
        )
        await self._board.hold(record)
        try:
            self._given_up(step.id)  # meanwhile, by another that asked this board as a seat
        except NotNow:
            await self._board.release(record)
            raise
        self._store.write(record)
        return record

    def _given_up(self, change: str) -> FleetRecord | None:
        """The record of a change that was prepared here before. Raises NotNow if the others have ended it already."""
        known = self._store.read(change)
        if known is not None and known.decision is not None:
            raise NotNow(f"change {change} was decided already: {known.decision.value}")
        if known is not None and known.state == member.OPEN:
            raise NotNow(f"change {change} came too late: other boards are ending it already")
        return known

    def _deadline(self, step: FleetStep) -> float:
        """When this board asks the seats; boards that are no seats ask later, so that few do so at a time."""
        return self._now() + step.seconds * (1.0 if self._name in step.seats else 1.5)

    def _refuse_while_another(self) -> None:
        last = self._store.last()
        if last is not None and not member.ended(last):
            raise Busy(
                f"change {last.id} of {last.caller or 'somebody'} is {last.state} here; "
                f"it ends by itself, or asks {', '.join(last.seats)} what was decided"
            )

    async def apply(self, step: FleetStep) -> FleetRecord:
        """Go to the new mode; the answer says whether the board is there. Raises NotNow."""
        record = self._known(step.id)
        before = record.state
        record = replace(member.after(record, Event.APPLY), deadline=self._deadline(step))
        self._store.write(record)
        return await self._work(record, begun=before == member.PREPARED)

    async def decide(self, step: FleetStep) -> FleetRecord:
        """Record the decision, and carry it out. Raises NotNow."""
        known = self._store.read(step.id)
        record = seats.told(known, step, self._name)
        before = known.state if known else record.state
        self._store.write(record)
        return await self._work(record, begun=before not in (member.APPLYING, member.REVERTING))

    def settle(self, step: FleetStep) -> FleetRecord:
        """What is known here about a change; as a seat, the promise of a ballot. It never waits. Raises NotNow."""
        known = self._store.read(step.id)
        return self._kept(known, seats.promised(known, step.id, step.ballot), bool(step.ballot))

    def vote(self, step: FleetStep) -> FleetRecord:
        """As a seat: vote in a ballot. It never waits. Raises NotNow."""
        known = self._store.read(step.id)
        return self._kept(known, seats.voted(known, step), True)

    def _kept(self, known: FleetRecord | None, record: FleetRecord, new: bool) -> FleetRecord:
        if new and record != known:
            self._store.write(record)
        return record

    def _known(self, change: str) -> FleetRecord:
        record = self._store.read(change)
        if record is None:
            raise NotNow(f"{self._name} has prepared no change {change}")
        return record

    # ---- what it does by itself -----------------------------------------------------------

    async def go_on(self) -> None:
        """Do whatever the record says is to be done; called at the start, and from time to time. Raises Unsettled."""
        record = self._store.last()
        if record is None:
            return
        if member.ended(record):  # a seat may have ended it without waiting, or the process before us was killed
            await self._board.release(record)
            return
        if member.todo(record, self._now()) is Todo.ASK_SEATS:
            record = await self._asked_the_seats(record)
        await self._work(record, begun=False)

    async def _asked_the_seats(self, record: FleetRecord) -> FleetRecord:
        decision = await seats.agreed(record.id, record.seats, self._ask)
        if decision is None:
            decision = seats.known(await self._others.ask(seats.who_may_know(record, self._name)))
        return self._known(record.id) if decision is None else self._changed(record.id, decision=decision)

    async def _ask(self, asks: Sequence[Ask]) -> dict[str, FleetRecord]:
        """The other seats, and this board if it is one."""
        answers = await self._others.ask([ask for ask in asks if ask.board != self._name])
        for ask in asks:
            if ask.board == self._name:
                with suppress(NotNow):
                    answers[ask.board] = self.vote(ask.step) if ask.verb is Verb.VOTE else self.settle(ask.step)
        return answers

    async def _work(self, record: FleetRecord, begun: bool) -> FleetRecord:
        """Load as long as the record wants it. `begun`: no load can have been requested before."""
        while True:
            step = member.todo(record, 0.0)
            if step not in (Todo.LOAD_NEW, Todo.LOAD_OLD):
                break
            record = await self._load(record, new=step is Todo.LOAD_NEW, begun=begun)
            begun = True
        if member.ended(record):
            await self._board.release(record)
        return record

    async def _load(self, record: FleetRecord, new: bool, begun: bool) -> FleetRecord:
        goal = (record.config_name, record.mode) if new else (record.old_config_name, record.old_mode)
        if not begun:  # the process before us may have begun it
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
        """The record as it is by now, after an event: as a seat this board may have decided meanwhile."""
        record = self._known(change)
        if decision is not None:
            record = member.decided(record, decision)
        if event is not None:
            record = member.after(record, event, error, seconds)
        self._store.write(record)
        return record
