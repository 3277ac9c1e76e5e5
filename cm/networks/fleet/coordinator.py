# SPDX-License-Identifier: Apache-2.0
"""A change of many boards: its coordinator.

    open     a transaction claims the boards for this change, under a lease, if their generations are what was read
    prepare  each board checks everything, keeps others off, and writes down where it is
    apply    each that the store has told of the claim goes there
    decide   one transaction: if the claims still stand, all boards are wanted there. Or the lease is revoked
    reconcile  boards look at what is wanted of them now: they stay, or let their managers undo the change

Boards are asked to prepare, and to reconcile after a decision, at the same time as the store: for the latter they wait
for its word. What is prepared without a claim is only kept from others, and ends when the board looks.
Until that transaction nothing is wanted that was not wanted before; from then on all of it is. If the coordinator
dies, the store ends its lease, the claims vanish, and no transaction can decide for the change any more.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

from cm.errors import Busy, CmError
from cm.networks.fleet.reconciling_board import NotNow
from cm.networks.fleet.store import (
    BOARDS,
    GENERATION,
    Claim,
    Entry,
    Put,
    Store,
    StoreAway,
    StoreRefused,
    View,
    Wanted,
    key,
    packed,
    views,
)
from cm.wire.messages.fleet import Decision, FleetState, FleetStep, Policy
from cm.wire.messages.status import ErrorInfo

Ask = Callable[  # boards, verb → each board's answer, or "no_answer", as it comes
    [Sequence[str], str, FleetStep], AsyncIterator[tuple[str, FleetState | ErrorInfo]]
]
_Asked = dict[str, FleetState | ErrorInfo]  # boards' answers, in the order in which they came
Progress = Callable[[str, str, FleetState | ErrorInfo], None]  # phase, board, its answer
LEASE = 5  # seconds that a coordinator may be silent: then others may close its change
_OPENING = LEASE + 3.0  # seconds for another's change to end: it may be one whose coordinator is dead
_NONE = Entry("0", 0)
_OPERATIONS = 128  # of one transaction, that etcd takes without --max-txn-ops
_FRESH = 1.0  # seconds for which boards stay prepared for a change that the store did not tell them of, and some
SETTLED = LEASE + 5.0  # seconds after which no board is undecided, from when the store answers and writes


def nothing(phase: str, board: str, answer: FleetState | ErrorInfo) -> None:
    """A receiver of progress that ignores it."""


def enough(policy: Policy, members: int, there: int) -> bool:
    """Whether `there` boards out of `members` in the new mode are enough for it to be kept."""
    if policy is Policy.ALL:
        return there == members
    return there * 2 > members if policy is Policy.QUORUM else there > 0


@dataclass(frozen=True, slots=True)
class Leg:
    """One phase of a change: seconds from the end of the one before, and the board that it waited for longest."""

    phase: str  # open, prepare, apply, decide, reconcile
    seconds: float
    slowest: str = ""


@dataclass
class Course:
    """A change that has ended.

    `decision` is None if the store did not answer when it was to decide: boards go to what it says. `states` are the
    boards' own words at the end, `silent` says why there is none. `causes`: what went wrong before the decision.
    `leased`: it was taken back, and the store has not ended its lease yet: until then boards wait.
    """

    id: str
    generation: int = 0
    decision: Decision | None = None
    states: dict[str, FleetState] = field(default_factory=dict)
    silent: dict[str, ErrorInfo] = field(default_factory=dict)
    causes: dict[str, ErrorInfo] = field(default_factory=dict)
    leased: bool = False
    touched: bool = False  # whether any board was asked to go anywhere
    figures: dict[str, FleetState] = field(default_factory=dict)  # the boards' answers of prepare and apply
    legs: list[Leg] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Of all phases."""
        return sum(leg.seconds for leg in self.legs)

    @property
    def differing(self) -> dict[str, str]:
        """Boards that are not where the decision wants them, or may not be, each with the reason."""
        found = {name: error.message for name, error in self.silent.items()}
        for name, state in self.states.items():
            if self.decision is Decision.KEEP:
                right = state.state == "there" and state.generation == self.generation
            else:
                right = not state.change and state.error is None
            if not right:
                found[name] = state.error.message if state.error else state.store_error or f"it is {state.state}"
        return found


@dataclass
class Coordinator:
    """One change, once. `choose`: its boards, by what is in the store, and those of them that are away.

    The latter are not asked, and go there when they are back. `caller` wants it. It may be cancelled at any moment:
    then it stops where it is.
    """

    store: Store
    ask: Ask
    caller: str
    change: str
    choose: Callable[[Mapping[str, View]], tuple[Sequence[str], Mapping[str, ErrorInfo]]]
    config: str = ""
    mode: str = ""
    policy: Policy = Policy.ALL
    tell: Progress = nothing
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], Awaitable[None]] = asyncio.sleep
    known: Mapping[str, Entry] = field(default_factory=dict)  # what was in the store last; empty: it is read
    members: Sequence[str] = ()
    _lease: str = ""
    _lost: bool = False  # the lease has ended

    def __post_init__(self) -> None:
        self.course = Course(self.change)
        self._views: Mapping[str, View] = {}
        self._generation = self._opened = 0
        self._goals: dict[str, tuple[str, str]] = {}
        self._early: asyncio.Task[_Asked] | None = None
        self._asked = self._ended = 0.0  # when boards were asked to prepare; the last leg

    async def run(self) -> Course:
        """Raises Busy, StoreAway, StoreRefused, and what `choose` does: then no board was asked to go anywhere."""
        self._ended, keeping = self.clock(), asyncio.ensure_future(self._keep())
        try:
            try:
                await self._open()
                there = await self._there()
            except CmError as error:
                if not isinstance(error, StoreAway):  # it would not hear that the lease is to end
                    await self._revoke()
                await self._give_up()
                raise
            except BaseException:  # cancelled before anything was decided: boards need not wait for the lease's end
                await self._revoke()
                raise
            await self._decide(there)
        finally:
            keeping.cancel()
            if self.course.decision is not Decision.KEEP:
                self._drop()
                self.known = {}
        if self.course.decision is Decision.KEEP and not self._claims_end:  # decided claims hold nobody up
            await asyncio.gather(self._revoke(), self._reconcile())
        else:
            await self._reconcile()
        return self.course

    # ---- opening ----------------------------------------------------------------------------

    async def _open(self) -> None:
        """Claim the boards: at once, if what is known of the store is new enough."""
        end, known = self.clock() + _OPENING, self.known
        self.known = known or await self.store.get("")
        while True:
            try:
                self._views = views(self.known)
                self.members, away = self.choose(self._views)
            except CmError:
                if self.known is not known:
                    raise
                self.known = await self.store.get("")
                continue
            self.course.causes, self.course.silent = dict(away), dict(away)
            self._there_now = [name for name in self.members if name not in away]
            mine = {n for n, view in self._views.items() if view.open and view.open.change == self.change}
            if mine == {*self.members}:
                break
            others = [(n, claim) for n in self.members if (claim := self._view(n).open) and n not in mine]
            late = self.clock() > end
            if others and late:
                name, claim = others[0]
                raise Busy(f"change {claim.change} of {claim.by} is open on {name}: try again when it has ended")
            if mine:  # and others have come into the inventory, or left it
                await self._revoke()
                self._lease = ""
            elif not others:
                try:
                    self.known = await self._claimed()
                    continue
                except StoreAway:  # it may have been done, or may still be
                    if late:
                        raise
            self._drop()
            await self.sleep(0.1)
            self.known = await self.store.get("")
        first = self._view(self.members[0])
        self._generation = self.course.generation = first.open.generation if first.open else 0
        self._opened = first.revision("claim")
        if self.clock() - self._asked > _FRESH:
            self._drop()
        self._leg_ended("open")

    async def _claimed(self) -> dict[str, Entry]:
        """What there is then: with our claims, if that was done."""
        self._drop()
        newest = self.known.get(GENERATION, _NONE)
        self._generation, self._lease = int(newest.value) + 1, self._lease or str(secrets.randbits(62) + 1)
        claim = Put(packed(Claim(self._generation, self.change, self.caller)), self._lease)
        puts: dict[str, Put | None] = {key(name, "claim"): claim for name in self.members}
        puts[GENERATION] = Put(str(self._generation))
        expect = {key(name, "wanted"): self._view(name).revision("wanted") for name in self.members}
        expect[GENERATION] = newest.revision  # every opening changes it
        self._begin("prepare", FleetStep(self.change, self.config, self.mode, self._generation))
        self._asked = self.clock()
        return await self.store.claim(expect, puts, self._lease, LEASE)

    async def _give_up(self) -> None:
        """Boards that are prepared, and not claimed, need not find that out by themselves."""
        if self._asked:
            asking = asyncio.ensure_future(self._answers("reconcile", self._there_now, FleetStep(self.change)))
            waiting = asyncio.ensure_future(self.sleep(_FRESH))
            await asyncio.wait((asking, waiting), return_when=asyncio.FIRST_COMPLETED)
            asking.cancel()
            waiting.cancel()

    @property
    def _claims_end(self) -> bool:
        """With the decision, if there is room: so boards are told of both at once. Else with their lease."""
        return 2 * len(self.members) <= _OPERATIONS

    def _view(self, name: str) -> View:
        return self._views.get(name, View())

    async def _keep(self) -> None:
        while not self._lost:
            await self.sleep(LEASE / 3)
            if not self._lease:
                continue
            with contextlib.suppress(StoreAway, StoreRefused):
                opened = bool(self._opened)
                self._lost = not await self.store.keep(self._lease) and opened

    # ---- the boards ---------------------------------------------------------------------------

    async def _there(self) -> list[str]:
        """Have the boards prepare, and go there; those that did."""
        step = FleetStep(self.change, self.config, self.mode, self._generation)
        answers = await self._step("prepare", self._there_now, step)
        ready = [name for name, state in answers.items() if state.state == "prepared"]
        self._goals = {name: (answers[name].config_name, answers[name].mode) for name in ready}
        self._goals |= {name: self._unasked(name) for name in self.members if name not in ready}
        if not ready or not self._enough(ready):
            return []
        self.course.touched = True
        answers = await self._step("apply", ready, FleetStep(self.change, generation=self._generation))
        return [name for name, state in answers.items() if state.state == "changed"]

    def _unasked(self, name: str) -> tuple[str, str]:
        """Where a board is to go that could not say what that means there: as it was wanted before, or as others."""
        wanted = self._view(name).wanted
        others = next(iter(self._goals.values()), ("", ""))
        return self.config or (wanted.config if wanted else others[0]), self.mode or others[1]

    def _enough(self, there: Sequence[str]) -> bool:
        """Under the policy `all`, boards that are known to be away do not count."""
        among = self._there_now if self.policy is Policy.ALL else self.members
        return not self._lost and enough(self.policy, len(among), len(there))

    def _begin(self, phase: str, step: FleetStep) -> None:
        """Ask all that are there, while the store is asked for what they wait for."""
        self._early = asyncio.ensure_future(self._answers(phase, self._there_now, step))

    def _drop(self) -> None:
        """The store did not do it, so their answers mean nothing."""
        if self._early is not None:
            self._early.cancel()
            self._early.add_done_callback(lambda task: task.cancelled() or task.exception())
            self._early = None

    async def _answers(self, phase: str, boards: Sequence[str], step: FleetStep) -> _Asked:
        found: _Asked = {}
        async for board, answer in self.ask(boards, phase, step):
            found[board] = answer
            self.tell(phase, board, answer)
        return found

    async def _leg(self, phase: str, boards: Sequence[str], step: FleetStep) -> _Asked:
        """Ask all at once, if that was not begun already, and again who had not heard of the store's word by then."""
        early, self._early = self._early, None
        found = await (early or self._answers(phase, boards, step))
        if early and (unaware := [name for name, answer in found.items() if self._unaware(phase, answer)]):
            found |= await self._answers(phase, unaware, step)
        self._leg_ended(phase, next(reversed(found), ""))
        return found

    def _unaware(self, phase: str, answer: FleetState | ErrorInfo) -> bool:
        if isinstance(answer, ErrorInfo):
            return phase == "prepare" and answer.code == NotNow.code
        return phase == "reconcile" and answer.change == self.change

    def _leg_ended(self, phase: str, slowest: str = "") -> None:
        before, self._ended = self._ended, self.clock()
        self.course.legs.append(Leg(phase, self._ended - before, slowest))

    async def _step(self, phase: str, boards: Sequence[str], step: FleetStep) -> dict[str, FleetState]:
        """A leg before the decision: the states of the boards that answered with one; what went wrong is a cause."""
        answers = await self._leg(phase, boards, step)
        errors = {n: answer if isinstance(answer, ErrorInfo) else answer.error for n, answer in answers.items()}
        self.course.causes |= {name: error for name, error in errors.items() if error is not None}
        states = {name: answer for name, answer in answers.items() if isinstance(answer, FleetState)}
        self.course.figures |= states
        return states

    # ---- the decision -------------------------------------------------------------------------

    async def _decide(self, there: Sequence[str]) -> None:
        if there and self._enough(there):
            self._begin("reconcile", FleetStep(self.change))
            self.course.decision = await self._kept()
        else:
            self.course.decision = Decision.REVERT  # nobody else could decide, and we never will
            if self._lost:
                self.course.causes.setdefault("the store", ErrorInfo("lease", "the coordinator's lease has ended"))
        if self.course.decision is Decision.REVERT:
            self.course.leased = not await self._revoke()
        self._leg_ended("decide")

    async def _revoke(self) -> bool:
        """False: it runs out by itself, as soon as the store can write that."""
        if not self._lease:
            return True
        try:
            await self.store.revoke(self._lease)
        except (StoreAway, StoreRefused) as error:
            self.course.causes.setdefault("the store", ErrorInfo(error.code, str(error)))
            return False
        return True

    async def _kept(self) -> Decision | None:
        """The transaction; one whose answer is lost is asked for again, and cannot be done twice.

        One that was refused, and no other, was not done, and never will be.
        """
        puts: dict[str, Put | None] = {}
        now = self.store.now()
        for name in self.members:
            wanted = Wanted(self._generation, *self._goals[name], self.caller, self.change, now)
            puts[key(name, "wanted")] = Put(packed(wanted))
        if self._claims_end:
            puts |= dict.fromkeys(key(name, "claim") for name in self.members)
        first = self.members[0]  # where a repetition finds that it was done
        expect = {key(name, "claim"): self._opened for name in self.members}
        expect[key(first, "wanted")] = self._view(first).revision("wanted")
        end, lost = self.clock() + SETTLED, False
        while True:
            try:
                if revision := await self.store.txn(expect, puts):
                    # With that the next change of this client may begin, without a reading.
                    known = {**self.known, **{k: Entry(put.value, revision) for k, put in puts.items() if put}}
                    self.known = {k: entry for k, entry in known.items() if not k.endswith("/claim")}
                    return Decision.KEEP
                self.known = {}
                return await self._told()
            except (StoreAway, StoreRefused) as error:
                self.course.causes["the store"] = ErrorInfo(error.code, str(error))
                lost = lost or isinstance(error, StoreAway)
                if not lost:
                    return Decision.REVERT
                if self.clock() > end:
                    return None
                await self.sleep(0.2)

    async def _told(self) -> Decision | None:
        """Why the transaction was refused: it had been done already, or the lease had ended."""
        first = self.members[0]
        found = views(await self.store.get(f"{BOARDS}{first}/")).get(first, View())
        if found.wanted is not None and found.wanted.change == self.change:
            return Decision.KEEP
        if found.generation > self._generation:  # by a later change, before which ours may have been kept
            return None
        self.course.causes.setdefault("the store", ErrorInfo("lease", "the coordinator's lease has ended"))
        return Decision.REVERT

    async def _reconcile(self) -> None:
        """Have all that are there look at what is wanted of them now."""
        answers = await self._leg("reconcile", self._there_now, FleetStep(self.change))
        self.course.states = {name: answer for name, answer in answers.items() if isinstance(answer, FleetState)}
        self.course.silent |= {name: answer for name, answer in answers.items() if isinstance(answer, ErrorInfo)}
