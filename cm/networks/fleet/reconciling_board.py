# SPDX-License-Identifier: Apache-2.0
"""A board of a fleet: it takes part in changes, and goes to what is wanted of it.

It never carries out a decision. It looks at what the store wants of it now, and at what it wrote down itself; so it
does not matter which messages it missed, how long it was away, or what its clock says. What it is given (the store,
its manager, its disk) are ports, so that a death at every point can be tested.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

from cm.errors import Busy, CmError, InvalidRequest
from cm.networks.fleet.keys import AGAIN
from cm.networks.fleet.store import BOARDS, Entry, Store, StoreAway, StoreRefused, View, Wanted, views
from cm.wire.messages.fleet import FleetState, FleetStep
from cm.wire.messages.status import ErrorInfo

Place = tuple[str, str]  # configuration and mode
NOTHING: Place = ("", "")
_FIRST, _LONGEST = 2.0, 300.0  # seconds until what failed is tried again: doubled each time
_PATIENCE = 1.0  # seconds for the store's word about what a coordinator asks for; after that it is read
_ALONE = (
    2.0  # seconds without a coordinator's word after which an open change is looked at, and one without a claim ends
)


class NotNow(CmError):
    """A step that the board's part in the change does not allow."""

    code = "fleet_state"


class NotUndone(CmError):
    """The manager has no way back of that change."""

    code = "nothing_to_undo"


class Unsettled(CmError):
    """The manager is away, or a change runs: where the board is cannot be said."""

    code = "unsettled"


@dataclass(frozen=True, slots=True)
class Part:
    """The board's part in an open change. It is written down before the work that it names is begun."""

    change: str
    generation: int
    caller: str
    old: Place
    goal: Place
    phase: str = "prepared"  # changing, changed, failing
    plan_seconds: float = 0.0
    plan_bytes: int = 0
    seconds: float = 0.0
    error: ErrorInfo | None = None
    wanted: int = -1  # the generation that was wanted here when it was prepared
    lease: str = ""  # the manager's, which keeps others off: by it the next process can renew it, or give it back


_NOWHERE, _NO_PART = Wanted(0, "", "", "", ""), Part("", 0, "", NOTHING, NOTHING)


@dataclass(frozen=True, slots=True)
class Notes:
    """What lies on the board's disk."""

    reached: int = 0  # the newest generation that the board has reached, or that a local change has set aside
    place: Place = NOTHING  # where the board was when it was last looked at,
    manager: int = 0  # and which manager said so
    part: Part | None = None


@dataclass(frozen=True, slots=True)
class Seen:
    """Where the board is, as its manager says, and which manager: its start is its name.

    `at`: when its last change ended, by the clock that the board is given.
    """

    place: Place
    manager: int
    at: float = field(default=0.0, compare=False)

    @property
    def is_broken(self) -> bool:
        """Whether a load, and the way back from it, have failed: nobody asks for a configuration without a mode."""
        return bool(self.place[0]) and not self.place[1]


@dataclass(frozen=True, slots=True)
class Planned:
    """Where a change would lead, and what it would involve."""

    place: Place
    seconds: float
    bytes: int


class Disk(Protocol):
    """`write` returns when a kill would not undo it. Raises OSError."""

    def read(self) -> Notes: ...
    def write(self, notes: Notes) -> None: ...


class OwnManager(Protocol):
    """The manager, asked in a caller's name. All raise CmError, and Unsettled if the manager is away."""

    async def where(self, known: Seen | None = None) -> Seen:
        """`known`: it need not be asked if that is what it told last."""

    async def plan(self, step: FleetStep, caller: str) -> Planned: ...
    async def hold(self, part: Part) -> str:
        """Keep others off the board; renewed while the change is open. The lease: the part's, or a new one."""

    async def release(self, part: Part) -> None: ...
    async def load(self, place: Place, caller: str, lease: str = "", undoable: str = "") -> float: ...
    async def undo(self, part: Part) -> None:
        """Raises NotUndone."""


class Board:
    """One board: what it does for its fleet, it does one after the other."""

    def __init__(
        self, name: str, store: Store, manager: OwnManager, disk: Disk, now: Callable[[], float],
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:  # fmt: skip
        """`now` is monotonic; nothing that it says is written down."""
        self._name, self._store, self._manager, self._disk, self._now = name, store, manager, disk, now
        self._sleep = sleep
        self._listening: set[asyncio.Future[None]] = set()  # steps that wait for the store's word
        self._asked = 0.0  # when a coordinator asked last
        self.wake = asyncio.Event()  # set: it has to be looked at, if no step does that meanwhile
        self._one = asyncio.Lock()
        self._notes = disk.read()
        self._entries: dict[str, Entry] = {}
        self._view = View()
        self._store_error = "it was not read yet"
        self._error: ErrorInfo | None = None  # of going to what is wanted
        self._again, self._pause = 0.0, _FIRST
        self._going = False
        self.place = self._notes.place

    @property
    def state(self) -> FleetState:
        """As it is told."""
        wanted, part = self._view.wanted or _NOWHERE, self._notes.part or _NO_PART
        error = self._error if part is _NO_PART else part.error
        return FleetState(
            self._word(), self._notes.reached, wanted.generation, wanted.config, wanted.mode, wanted.by, part.change,
            *part.goal, error, self._store_error, part.plan_seconds, part.plan_bytes, part.seconds,
        )  # fmt: skip

    def _word(self) -> str:
        wanted, notes = self._view.wanted, self._notes
        if notes.part is not None:
            return notes.part.phase
        if wanted is None:
            return "free"
        if wanted.generation < notes.reached:
            return "behind"
        if wanted.generation == notes.reached:
            return "there" if self.place == wanted.place else "drift"
        return "failed" if self._error and not self._going else "going"

    # ---- what a coordinator asks for ----------------------------------------------------------

    async def step(self, verb: str, step: FleetStep, caller: str) -> FleetState:
        """prepare: check everything for a change, keep others off the board, and write down where it is.

        apply: go to the new mode; the answer says whether the board is there. reconcile: as `look`. Raises NotNow if
        the store has another change open here, or not that which is to be applied, or it was not prepared, StoreAway,
        Busy, Unsettled, and the manager's refusals.
        """
        self._asked = self._now()
        await self._hear(verb, step)
        async with self._one:
            self.wake.clear()
            if verb == "apply":
                await self._apply(step)
            else:
                await self._look(step.id == AGAIN, step)
            if verb == "prepare":
                await self._prepare(step, caller)
            return self.state

    async def _hear(self, verb: str, step: FleetStep) -> None:
        """Wait for the store's word, which a coordinator asks for at the same time: its change is open, or decided."""
        patience = asyncio.ensure_future(self._sleep(_PATIENCE))
        try:
            while self._is_early(verb, step) and not patience.done():
                self._listening.add(word := asyncio.get_running_loop().create_future())
                await asyncio.wait((word, patience), return_when=asyncio.FIRST_COMPLETED)
        finally:
            patience.cancel()

    def _is_early(self, verb: str, step: FleetStep) -> bool:
        claim, part = self._view.open, self._notes.part
        if verb == "prepare":  # the store may be about to tell of the other change
            return claim is None and part is not None and part.change != step.id and part.phase == "prepared"
        if verb == "apply":
            return not self._claimed_for(step)
        return claim is not None and claim.change == step.id

    async def _prepare(self, step: FleetStep, caller: str) -> None:
        known = self._notes.part
        if known is not None:
            if known.change != step.id:
                raise Busy(f"change {known.change} of {known.caller} is {known.phase} here, and not ended yet")
            return
        if not self._may_be_open(step):
            raise NotNow(f"another change is open here, or wanted already: {step.id} came too late")
        if self.place == NOTHING:
            raise NotNow("nothing is loaded on this board, so there would be no way back: load something first")
        part = Part(step.id, step.generation, caller, self.place, NOTHING, wanted=self._view.generation)
        plan, lease = await asyncio.gather(  # together: a manager that was woken for one answers both
            self._manager.plan(step, caller), self._manager.hold(part), return_exceptions=True
        )
        if isinstance(plan, BaseException):
            if isinstance(lease, str):
                await self._manager.release(replace(part, lease=lease))
            raise plan
        if isinstance(lease, BaseException):
            raise lease
        planned = replace(part, goal=plan.place, plan_seconds=plan.seconds, plan_bytes=plan.bytes)
        await self._note_held(planned, lease)

    async def _note_held(self, part: Part, lease: str) -> None:
        """A lease that cannot be written down is given back: nobody would know of it."""
        try:
            self._write(part=replace(part, lease=lease))
        except OSError:
            await self._manager.release(replace(part, lease=lease))
            raise

    async def _apply(self, step: FleetStep) -> None:
        part = self._notes.part
        if part is None or part.change != step.id:
            raise NotNow(f"change {step.id} was not prepared here, or is undone already")
        if part.phase != "prepared":
            return
        if not self._claimed_for(step):
            await self._read()
        if not self._claimed_for(step):
            raise NotNow(
                f"the store has no change {step.id} open here: it came too late, or "
                "this bridge's --store is another than that of who changes"
            )
        if part.wanted != self._view.generation:
            raise NotNow("something newer was wanted here when it prepared, of which it had not heard: try again")
        part = replace(part, generation=step.generation, phase="changing")
        self._write(part=part)
        try:
            seconds = await self._manager.load(part.goal, part.caller, part.lease, part.change)
        except Unsettled:
            raise
        except CmError as error:
            self._write(part=replace(part, phase="failing", error=ErrorInfo(error.code, str(error))))
        else:
            self._write(part=replace(part, phase="changed", seconds=seconds))

    # ---- what it does by itself -----------------------------------------------------------------

    async def look(self) -> str:
        """Do what is wanted of it now; returns why that is not possible yet, empty if all is done."""
        async with self._one:
            self.wake.clear()
            try:
                await self._look()
            except (CmError, OSError) as error:
                return str(error)
            return self._store_error

    def remind(self) -> None:
        """Have it looked at, if there is something to do and nobody is at it: who changes the fleet asks soon again."""
        if self.unsettled and not self._one.locked() and self._now() - self._asked >= _ALONE:
            self.wake.set()

    async def _look(self, again: bool = False, step: FleetStep | None = None) -> None:
        """Read what is wanted, and do it. `again`: also what failed before, or was changed by hand. Raises Unsettled.

        `step`: what a coordinator asks for; if the store has told of that already, it is not read.
        If the store cannot be read, nothing is done: what is open stays open, and the manager's lock on the board runs
        out, so that its local users are free.
        """
        part = self._notes.part
        if part and part.phase == "prepared" and not self._view.open and self._is_given_up(part, step):
            await self._manager.release(part)  # whether the store answers or not
            self._write(part=None)
        if step is None or not self._told_of(step):
            try:
                await self._read()
            except (StoreAway, StoreRefused) as error:
                self._store_error = str(error)
                return
        if again:
            self._again = 0.0
        await self._reconcile(again, asked=step is not None)

    def _is_given_up(self, part: Part, step: FleetStep | None) -> bool:
        """Of a change that nobody has claimed, as far as is known: its coordinator says so, or nothing any more."""
        if step is None:
            return bool(self._asked) and self._now() - self._asked >= _ALONE
        return step.id == part.change and not step.generation

    async def _read(self) -> None:
        self._know(await self._store.get(f"{BOARDS}{self._name}/"))
        self._store_error = ""

    def told(self, changes: Mapping[str, Entry]) -> None:
        """Take what the store's watch says has changed."""
        known = self._entries
        newer = {k: entry for k, entry in changes.items() if k not in known or entry.revision > known[k].revision}
        try:
            self._know({k: entry for k, entry in {**known, **newer}.items() if entry.value})
        except InvalidRequest:  # who looks is told
            self.wake.set()
        if not changes or self.unsettled:
            self.wake.set()

    def _know(self, entries: dict[str, Entry]) -> None:
        self._entries, self._view = entries, views(entries).get(self._name, View())
        while self._listening:
            word = self._listening.pop()
            if not word.done():
                word.set_result(None)

    def _claimed_for(self, step: FleetStep) -> bool:
        claim = self._view.open
        return claim is not None and (claim.change, claim.generation) == (step.id, step.generation)

    def _may_be_open(self, step: FleetStep) -> bool:
        """A change that is to be prepared: the store may not have told of it yet."""
        return self._claimed_for(step) or (self._view.open is None and step.generation > self._view.generation)

    def _told_of(self, step: FleetStep) -> bool:
        """Whether what is known will do: this change may be open here, or was decided. What was told may be old."""
        part, wanted = self._notes.part, self._view.wanted
        if part is None:
            return not self.unsettled and self._may_be_open(step)
        return not self._store_error and wanted is not None and wanted.change == part.change == step.id

    @property
    def listed(self) -> bool:
        """Whether it is in the inventory, as far as is known."""
        return self._view.settings is not None

    @property
    def in_a_change(self) -> bool:
        """Whether one is open here, as far as is known, or is about to be."""
        return self._one.locked() or self._notes.part is not None or self._view.open is not None

    def seen(self, place: Place) -> None:
        """Take what its manager says; if nothing that is done here explains it, somebody has taken it elsewhere."""
        if self._notes.part is None and not self._going and place != self.place:
            self.wake.set()

    @property
    def unsettled(self) -> bool:
        """Whether it has to be looked at again without being told to."""
        wanted = self._view.generation > self._notes.reached
        return self._notes.part is not None or wanted or bool(self._store_error)

    async def _reconcile(self, again: bool, asked: bool) -> None:
        """`asked`: by a coordinator, which waits: then what the manager told last counts, where it is as noted."""
        part, notes = self._notes.part, self._notes
        if part is not None:
            claim = self._view.open
            if claim is not None and claim.change == part.change:
                await self._note_held(part, await self._manager.hold(part))
                return
            seen = await self._end(part, kept=self._view.generation == part.generation)
        else:
            seen = await self._manager.where(Seen(notes.place, notes.manager) if asked else None)
        self._notice(seen, again)
        wanted = self._view.wanted
        if wanted is None:
            return
        if wanted.generation <= self._notes.reached:
            self._error = None
        elif self._now() >= self._again:
            await self._go(wanted.place, wanted.by, wanted.generation)

    async def _end(self, part: Part, kept: bool) -> Seen:
        """The change is decided, or its coordinator gone: stay, or have it undone. Returns where the board is then."""
        there = kept and part.phase == "changed"
        seen = await self._manager.where(Seen(part.goal, self._notes.manager) if there else None)
        if there and seen.place == part.goal:
            await self._manager.release(part)
            self._is_at(seen, part=None, reached=part.generation)
            return seen
        changes: dict[str, object] = {}  # where it is now is found out by `_notice`, which knows where it was
        if not kept and part.phase != "prepared" and self._still_ours(part, seen):
            try:
                await self._back(part, seen)
            except Unsettled:
                raise
            except CmError as error:  # told, and from then on a board that is not where it is wanted
                self._error = ErrorInfo(error.code, f"change {part.change} could not be undone: {error}")
                changes = {"reached": max(0, min(self._notes.reached, self._view.generation - 1))}
            seen = await self._manager.where()
            changes |= {"place": seen.place, "manager": seen.manager} if changes else {}
        await self._manager.release(part)
        self._write(part=None, **changes)
        return seen

    async def _back(self, part: Part, seen: Seen) -> None:
        try:
            await self._manager.undo(part)
        except NotUndone:  # the manager went back by itself, or the hardware was lost with its power
            if seen.place != part.old:
                await self._manager.load(part.old, part.caller, part.lease)

    def _still_ours(self, part: Part, seen: Seen) -> bool:
        """Whether nobody took the board elsewhere meanwhile: its lock may have run out while the store was away."""
        ours = seen.place in (part.old, part.goal, NOTHING) or seen.is_broken
        return ours or seen.manager != self._notes.manager

    def _notice(self, seen: Seen, again: bool) -> None:
        """Find out whether somebody took the board elsewhere: that stays, until something new is wanted.

        What is newer counts, by the store's clock, whenever it is noticed. After a restart of the manager nobody can
        tell an operator from a loss of power: what is wanted counts then, and where a load has failed, too.
        """
        notes, wanted = self._notes, self._view.wanted
        reached = notes.reached
        if (seen.place, seen.manager) != (notes.place, notes.manager) and wanted is not None:
            by_hand = seen.manager == notes.manager and not seen.is_broken and seen.place != wanted.place
            if not by_hand:
                reached = min(reached, wanted.generation - 1)
            elif wanted.at <= self._store.now() - (self._now() - seen.at):
                reached = max(reached, wanted.generation)
        if again and wanted is not None and seen.place != wanted.place:
            reached = min(reached, wanted.generation - 1)
        self._is_at(seen, reached=reached)

    async def _go(self, place: Place, by: str, generation: int) -> None:
        """Go to what is wanted; a failure is told, and tried again later."""
        self._going = True
        try:
            if self.place != place:
                await self._manager.load(place, by)
            self._is_at(await self._manager.where(), reached=generation)
            self._error, self._pause = None, _FIRST
        except Unsettled:
            raise
        except CmError as error:
            self._error = ErrorInfo(error.code, str(error))
            self._again = self._now() + self._pause
            self._pause = min(2 * self._pause, _LONGEST)
            self._is_at(await self._manager.where())
        finally:
            self._going = False

    # ---- the disk -------------------------------------------------------------------------------

    def _is_at(self, seen: Seen, **changes: object) -> None:
        self.place = seen.place
        self._write(place=seen.place, manager=seen.manager, **changes)

    def _write(self, **changes: object) -> None:
        notes = replace(self._notes, **changes)  # type: ignore[arg-type]
        if notes != self._notes:
            self._disk.write(notes)
            self._notes = notes
