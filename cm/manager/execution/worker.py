# SPDX-License-Identifier: Apache-2.0
"""Changes wait for their turn; a thread runs one after the other, and each ends exactly once, whatever happens."""

from __future__ import annotations

import functools
import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from cm.errors import CmError
from cm.manager import planner
from cm.manager.access.leases import Leases
from cm.manager.errors import Cancelled, ChangeBusy
from cm.manager.execution.rollback import Rollback, failure_of
from cm.manager.execution.transaction import StepContext, Tools, plan_to, take_steps
from cm.manager.planner import Goal
from cm.manager.state.board_state import BoardState, RegionPhase
from cm.manager.state.record import Pending, WayBack
from cm.manager.state.steps import Place
from cm.schema.model import ConfigType
from cm.wire.messages.status import ChangeInfo, ErrorInfo, Reply

QUEUE_LENGTH = 8


@dataclass(eq=False)
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
    undoing: bool = False  # that change before it: void only once this one has ended well
    undoable: str = ""  # the name under which its own way back is kept
    _cancel: threading.Event = field(default_factory=threading.Event)
    _done: threading.Event = field(default_factory=threading.Event)

    def cancel(self) -> None:
        """Ask it to stop before its next load; it goes back to the mode before."""
        self._cancel.set()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._cancel.is_set()

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._done.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end; False if it did not come in time."""
        return self._done.wait(timeout)

    def reply(self) -> Reply:
        """What the client is told at its end."""
        ended = ChangeInfo(self.number, done=True, seconds=self.seconds, generation=self.generation)
        return Reply(ended) if self.error is None else Reply(error=self.error)

    def finish(self, error: ErrorInfo | None, seconds: float) -> None:
        """Its end."""
        self.error, self.seconds = error, seconds
        self._done.set()
        if self.on_done is not None:
            self.on_done(self)


class Worker:
    """The queue of changes and its thread. A defect in one change, or at its end, must not harm later ones."""

    def __init__(self, tools: Tools, leases: Leases, prefetches: bool) -> None:
        """`prefetches`: between changes, images of the loaded configuration are read ahead."""
        self._tools = tools
        self._leases = leases
        self._prefetches = prefetches
        self._queue: queue.Queue[Change | None] = queue.Queue(QUEUE_LENGTH)
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
        try:
            self._queue.put_nowait(change)
        except queue.Full:
            raise ChangeBusy(f"{QUEUE_LENGTH} changes wait already; try again when one has ended") from None
        self._newest = change
        return change

    @property
    def coming(self) -> str | None:
        """The configuration of the change that was asked for last; None where it has ended."""
        return self._newest.config if self._newest is not None and not self._newest.done else None

    @property
    def busy(self) -> bool:
        """Whether a change runs or waits."""
        return self._queue.unfinished_tasks > 0

    def wait_idle(self) -> None:
        """Wait until no change runs or waits."""
        self._queue.join()

    # ---- the worker's thread ------------------------------------------------------------

    def _work(self) -> None:
        while (change := self._queue.get()) is not None:
            try:
                self._turn(change)
            except Exception as problem:  # noqa: BLE001 (the thread has to live)
                self._tools.reporter.set_error(_internal(problem))
                self._tools.reporter.changed()
        self._queue.task_done()

    def _turn(self, change: Change) -> None:
        if self._stopping.is_set():
            self._queue.task_done()
            change.finish(ErrorInfo("cancelled", "the configuration manager is stopping"), 0.0)
            return
        self._run(change)
        if change.error is None and self._prefetches and self._queue.empty():
            self._tools.loaders.prefetch_modules(self._tools.state.loaded_config(), self._queue.empty)

    def _run(self, change: Change) -> None:
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
        seconds = time.monotonic() - started
        state.pending, self.running = None, None
        reporter.ended(change.number, error, seconds)
        state.release_regions()
        reporter.note(state.try_record())
        self._queue.task_done()
        reporter.changed()
        change.finish(error, seconds)

    def _begin(self, change: Change) -> None:
        state, self.running = self._tools.state, change
        if change.asked and not change.undoing:
            state.way_back = None
        board, whole = state.board, state.configs[change.config].type is ConfigType.FULL
        there = board.config == change.config and not change.force
        full = (whole and not there) or change.static is not None
        self._tools.reporter.begun(change.number, change.config, change.mode, full)
        state.pending = Pending(
            change.number,
            change.config,
            change.mode,
            board.config,
            board.mode,
            from_static=board.static_config,
            held=_held(board),
            values={**board.values, **change.values},
            found=tuple((*place, value) for place, value in change.found.items()),
            rates=change.rates,
        )

    def _outcome(self, change: Change) -> ErrorInfo | None:
        try:
            self._take(change)
        except CmError as problem:
            return ErrorInfo(getattr(problem, "cause_code", problem.code), str(problem))
        except Exception as problem:  # noqa: BLE001 (a defect of ours must not end the worker)
            return _internal(problem)
        return None

    def _take(self, change: Change) -> None:
        if change.cancelled:
            raise Cancelled("the change was cancelled before it began")
        self._leases.check(change.scopes, change.lease)  # one may have been given while this change waited
        configs = self._tools.state.configs
        config = planner.config_named(change.config, configs)  # it may have been taken away while this change waited,
        mode = planner.mode_of(config, change.mode)  # or provisioned anew
        static = configs.get(change.static or "")
        also = tuple(name for name in change.also if name in config.modules)
        goal = Goal(config, mode, change.force, change.values, also, static, change.rates, change.found)
        self._go_to(goal, change)

    def _go_to(self, goal: Goal, change: Change) -> None:
        """Go there, or back to where the board was.

        Raises what the plan says is wrong (nothing was touched then), StepFailed (the board went back)
        or UndoFailed (regions stay decoupled).
        """
        before = self._tools.state.board
        run = StepContext(plan_to(goal, self._tools), self._tools, change.number, lambda: change.cancelled)
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
        plan = plan_to(goal, self._tools)
        back = StepContext(plan, self._tools, failed.number, lambda: False, best_effort=True, sealed=failed.sealed)
        take_steps(back, goal)


def _internal(problem: Exception) -> ErrorInfo:
    return ErrorInfo("internal", f"{type(problem).__name__}: {problem}")


def _held(board: BoardState) -> dict[str, str]:
    ready = {name: region.module for name, region in board.regions.items() if region.phase is RegionPhase.READY}
    return {name: module for name, module in ready.items() if module is not None}
