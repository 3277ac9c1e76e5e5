# SPDX-License-Identifier: Apache-2.0
"""Changes wait for their turn; a thread runs one after the other, and each ends exactly once, whatever happens."""

from __future__ import annotations

import functools
import queue
import threading
from collections.abc import Callable, Mapping

from cm.errors import CmError
from cm.frozen import dataclass, field, replace
from cm.manager import planner
from cm.manager.access.leases import Leases
from cm.manager.errors import Cancelled, ChangeBusy, RegionWrong
from cm.manager.execution.region_readback import Pace, Scan, bits_of, checked_region
from cm.manager.execution.rollback import Rollback, failure_of
from cm.manager.execution.transaction import StepContext, Tools, plan_to, take_steps
from cm.manager.planner import Goal, Plan
from cm.manager.state.board_state import BoardState, RegionPhase
from cm.manager.state.journal import Pending, WayBack
from cm.manager.state.steps import Place, Repair, Validate
from cm.manager.touched import ALL, Thing
from cm.schema.model import ConfigType
from cm.wire.messages.requests import ChangeMode
from cm.wire.messages.status import ChangeInfo, ErrorInfo, PastChange, RegionCheck, Reply

QUEUE_LENGTH = 8
SCANS = 16  # that may wait or run


@dataclass(slots=True, eq=False)
class Change:
    """A requested change; waited for, cancelled, and called back at its end from the worker's thread."""

    number: int
    config: str
    mode: str
    force: bool = False
    static: str | None = None  # the full configuration to load first, on the way back to a partial one
    scopes: tuple[str, ...] = ()  # what leases of others must not cover
    lease: str = ""  # the requester's own
    error: ErrorInfo | None = None
    seconds: float = 0.0
    generation: int = 0  # of the registers at its end
    on_done: Callable[[Change], None] | None = None
    also: tuple[str, ...] = ()  # modules of regions that the mode leaves alone, which the way back restores
    values: Mapping[str, int] = field(default_factory=dict)  # registers that it restores
    found: Mapping[Place, int] = field(default_factory=dict)  # others, likewise
    rates: Mapping[str, int] = field(default_factory=dict)  # clocks that it restores, in Hz
    asked: bool = False  # by a client, so that the way back of the change before it is void
    since: BoardState | None = None  # what clients have written after that stays
    resumes: Pending | None = None  # one that was cut short, whose way back this is
    undoing: bool = False  # that change before it: void only once this one has ended well
    undoable: str = ""  # the name under which its own way back is kept
    unload: str = ""  # as of `ChangeMode`; `mode` is then the one that is left
    repairs: str = ""  # a region that it compares with what was loaded, and repairs; it goes nowhere else
    reloads: bool = False  # that region as a whole
    checked: RegionCheck | None = None  # what came of that
    cancelled: bool = False  # `cancel` was called
    by: str = ""  # who asked for it, for people
    why: str = ""  # where nobody asked for it
    _done: threading.Event = field(default_factory=threading.Event)

    def cancel(self) -> None:
        """Ask it to stop before its next load; it goes back to the mode before."""
        self.cancelled = True

    @property
    def touches(self) -> tuple[Thing, ...]:
        """The regions that it keeps to; everything where it keeps to none."""
        regions = [scope.partition(":")[2] for scope in self.scopes if scope.startswith("region:")]
        if self.force or self.undoing or not regions:
            return (Thing(ALL, ALL),)
        return tuple([Thing(self.config, name) for name in regions])

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._done.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end; False if it did not come in time."""
        return self._done.wait(timeout)

    def reply(self) -> Reply:
        """What the client is told at its end."""
        if self.checked is not None and self.error is None:
            return Reply(replace(self.checked, change=self.number, seconds=self.seconds))
        ended = ChangeInfo(self.number, done=True, seconds=self.seconds, generation=self.generation)
        return Reply(ended) if self.error is None else Reply(error=self.error)

    def finish(self, error: ErrorInfo | None) -> None:
        """Its end."""
        self.error = error
        self._done.set()
        if self.on_done is not None:
            self.on_done(self)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A check that takes its turns between changes; `done` is told that it is over, or what went wrong."""

    scan: Scan
    done: Callable[[Exception | None], None]
    pace: Pace | None = None  # called after each slice but the last: the next comes when it says so


class Worker:
    """The queue of changes and its thread. A defect in one change, or at its end, must not harm later ones."""

    def __init__(self, tools: Tools, leases: Leases) -> None:
        self._tools = tools
        self._leases = leases
        self._queue: queue.SimpleQueue[Change | Look | None] = queue.SimpleQueue()
        self._count = threading.Condition()
        self._changes = self._scans = 0  # that wait or run
        self._thread = threading.Thread(target=self._work, name="cm-changes", daemon=True)
        self._stopping = threading.Event()
        self._newest: Change | None = None
        self.running: Change | None = None

    def start(self) -> None:
        """Begin with what waits."""
        self._thread.start()

    def stop(self) -> None:
        """End after the running change; those that wait are refused as cancelled."""
        self._stopping.set()
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def add(self, change: Change) -> Change:
        """Let a change wait for its turn. Raises ChangeBusy if too many wait."""
        with self._count:
            if self._changes - (self.running is not None) >= QUEUE_LENGTH:
                raise ChangeBusy(f"{QUEUE_LENGTH} changes wait already; try again when one has ended")
            self._changes += 1
        self._queue.put(change)
        self._newest = change
        return change

    def look(self, look: Look) -> None:
        """Let a check wait for its turns, a slice in each. Raises ChangeBusy if too many wait."""
        with self._count:
            if self._scans >= SCANS:
                raise ChangeBusy(f"{SCANS} checks of regions run or wait already; try again when one has ended")
            self._scans += 1
        self._queue.put(look)

    @property
    def coming(self) -> str | None:
        """The configuration of the change that was asked for last; None where it has ended."""
        return self._newest.config if self._newest is not None and not self._newest.done else None

    @property
    def busy(self) -> bool:
        """Whether a change runs or waits."""
        return self._changes > 0

    def wait_idle(self) -> None:
        """Wait until no change runs or waits."""
        with self._count:
            self._count.wait_for(lambda: not self._changes)

    def _ended(self) -> None:
        with self._count:
            self._changes -= 1
            self._count.notify_all()

    # ---- the worker's thread ------------------------------------------------------------

    def _work(self) -> None:
        while (work := self._queue.get()) is not None:
            try:
                if isinstance(work, Look):
                    self._take_look(work)
                else:
                    self._turn(work)
            except Exception as problem:  # noqa: BLE001 (the thread has to live)
                self._tools.reporter.set_error(_internal(problem))
                self._tools.reporter.changed()

    def _take_look(self, look: Look) -> None:
        """Read a slice of a region; the next one after the changes that wait now."""
        started = self._tools.time.monotonic()
        try:
            if self._stopping.is_set():
                raise Cancelled("the configuration manager is stopping")
            if not look.scan.step():
                again = functools.partial(self._queue.put, look)
                if look.pace is None:
                    again()
                else:
                    look.pace(self._tools.time.monotonic() - started, again)
                return
        except Exception as problem:  # noqa: BLE001 (whoever asked is told)
            self._over(look, problem)
        else:
            self._over(look, None)

    def _over(self, look: Look, error: Exception | None) -> None:
        look.scan.close()
        with self._count:
            self._scans -= 1
        look.done(error)

    def _turn(self, change: Change) -> None:
        if self._stopping.is_set():
            self._ended()
            change.finish(ErrorInfo("cancelled", "the configuration manager is stopping"))
            return
        self._run_change(change)
        self._tools.state.keep_times()
        self._tools.loaders.prefetch_modules(self._tools.state.loaded_config(), lambda: not self.busy)

    def _run_change(self, change: Change) -> None:
        """Run a change and finish it; the next may be requested before the end of this one is published."""
        state, reporter, time = self._tools.state, self._tools.reporter, self._tools.time
        started = time.monotonic()
        self._begin(change)
        error = self._outcome(change)
        if error is None and change.asked:
            assert state.pending is not None
            state.way_back = WayBack(change.undoable, state.pending) if change.undoable else None
        change.generation = state.written()
        self._tools.data_plane.wrote(change.generation)
        change.seconds = time.monotonic() - started
        touched = state.pending is not None and state.pending.touched
        state.pending, self.running = None, None
        reporter.history.ended(error)
        reporter.ended(change.number, error, change.seconds, touched)
        state.release_regions()
        reporter.note(state.settle())
        self._ended()
        reporter.changed()
        change.finish(error)

    def _begin(self, change: Change) -> None:
        state, self.running = self._tools.state, change
        if change.asked and not change.undoing:
            state.way_back = None
        board, whole = state.board, state.configs[change.config].type is ConfigType.FULL
        if change.unload:
            change.mode = planner.mode_left(state.configs[change.config], board.mode, change.unload)
        there = board.config == change.config and not change.force
        full = (whole and not there) or change.static is not None
        before = board.config or "", board.mode or ""
        self._tools.reporter.history.begun(
            PastChange(change.number, change.config, change.mode, *before, change.by, change.why)
        )
        self._tools.reporter.begun(change.number, change.config, change.mode, full)
        values = {**board.values, **change.values}
        state.pending = change.resumes and replace(change.resumes, values=values, touched=False)
        state.pending = state.pending or Pending(
            change.number,
            change.config,
            change.mode,
            board.config,
            board.mode,
            from_static=board.static_config,
            held={
                name: region.module
                for name, region in board.regions.items()
                if region.phase is RegionPhase.READY and region.module is not None
            },
            values=values,
            found=tuple((*place, value) for place, value in change.found.items()),
            rates=change.rates,
        )

    def _outcome(self, change: Change) -> ErrorInfo | None:
        try:
            self._carry_out(change)
        except CmError as problem:
            return ErrorInfo(getattr(problem, "cause_code", problem.code), str(problem))
        except Exception as problem:  # noqa: BLE001 (a defect of ours must not end the worker)
            return _internal(problem)
        return None

    def _carry_out(self, change: Change) -> None:
        if change.cancelled:
            raise Cancelled("the change was cancelled before it began")
        self._leases.check(change.scopes, change.lease)  # one may have been given while this change waited
        if change.repairs:
            self._repair(change)
            return
        configs = self._tools.state.configs
        if change.unload:
            request = ChangeMode(change.config, unload=change.unload)
            config, _ = planner.target(request, configs, self._tools.state.board.config)
            self._go_to(Goal(config, change.mode, unload=change.unload), change)
            return
        config = planner.config_named(change.config, configs)  # it may have been taken away while this change waited,
        mode = planner.mode_of(config, change.mode)  # or provisioned anew
        static = configs.get(change.static or "")
        also = tuple(name for name in change.also if name in config.modules)
        since = change.since or self._tools.state.board
        values = {**change.values, **self._tools.state.board.values_since(since, ())}
        goal = Goal(config, mode, change.force, values, also, static, change.rates, change.found)
        self._go_to(goal, change)

    def _repair(self, change: Change) -> None:
        """Compare a region; write its wrong frames anew, or load it again; compare again.

        Raises RegionWrong where it differs also after that.
        """
        before = self._scan(change)
        change.checked = first = before.result(0.0)
        if not before.wrong:
            return
        what, words = before.what, None if change.reloads else before.what.frames.repair(before.wrong)
        after, how = before, "frames"
        if words is not None:
            timeout = self._tools.state.throughput.timeout(what.region, len(words))
            step = Repair(what.region, what.module, what.image, words, len(before.wrong), timeout)
            goal = Goal(what.config, what.mode)
            self._go_to(goal, change, Plan(goal, (Validate((what.image,)), step)))
            after = self._scan(change)
        if after.wrong:
            how = "load"
            also = () if what.module.name in what.config.modes[what.mode].modules else (what.module.name,)
            values = self._tools.state.board.values
            config = self._tools.state.configs[what.config.name]
            self._go_to(Goal(config, what.mode, values=values, also=also, reload=(what.region.name,)), change)
            after = self._scan(change)
        if after.wrong:
            bits = after.result(0.0).wrong_bits
            raise RegionWrong(f"region {change.repairs} differs in {bits} bits also after it was loaded again")
        self._tools.reporter.health.repaired(change.repairs)
        change.checked = replace(first, verdict="good", repaired=how)

    def _scan(self, change: Change) -> Scan:
        tools = self._tools
        what = checked_region(change.repairs, tools.state, tools.devices, tools.files)
        scan = Scan(what, tools.state, tools.devices)
        scan.run()
        self.note(scan)
        return scan

    def note(self, scan: Scan) -> None:
        """A check went over all of a region."""
        self._tools.reporter.health.checked(scan.result(0.0), bits_of(scan.wrong))

    def _go_to(self, goal: Goal, change: Change, plan: Plan | None = None) -> None:
        """Go there, by a plan that was made already where there is one, or back to where the board was.

        Raises what the plan says is wrong (nothing was touched then), StepFailed (the board went back)
        or UndoFailed (regions stay decoupled).
        """
        before = self._tools.state.board
        run = StepContext(plan or plan_to(goal, self._tools), self._tools, change.number, lambda: change.cancelled)
        if not run.plan.steps:
            self._check_board()
        try:
            take_steps(run, goal)
        except Exception as error:  # defects of ours too: they must not leave the board half changed
            rollback = Rollback(self._tools, before, functools.partial(self._go_back, run), run.sealed)
            raise rollback.run(failure_of(run, error)) from error  # in no variable: its traceback has this frame

    def _check_board(self) -> None:
        """Ask the board for anything: nobody would notice its absence if nothing is to be done. Raises its error."""
        try:
            self._tools.devices.check()
        except CmError:
            self._tools.loaders.forget()
            self._tools.registers.forget(lost=True)
            raise

    def _go_back(self, failed: StepContext, goal: Goal) -> None:
        plan = plan_to(goal, self._tools, back=True)
        back = StepContext(plan, self._tools, failed.number, lambda: False, best_effort=True, sealed=failed.sealed)
        take_steps(back, goal)


def _internal(problem: Exception) -> ErrorInfo:
    return ErrorInfo("internal", f"{type(problem).__name__}: {problem}")
