# SPDX-License-Identifier: Apache-2.0
"""A change of mode from request to end: plan, run, and go back when it fails."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from cm.errors import CmError
from cm.manager import plan as planning
from cm.manager.cost import Throughput
from cm.manager.errors import StepFailed, UndoFailed
from cm.manager.ports import Files
from cm.manager.state import BoardState, RegionPhase
from cm.manager.transaction import Board, Tools, Transaction, abandon
from cm.messages.status import ErrorInfo
from cm.schema.model import Config


@dataclass(eq=False)
class Change:
    """A requested change; waited for, cancelled, and called back at its end from the worker's thread."""

    number: int
    config: str
    mode: str
    force: bool = False
    error: ErrorInfo | None = None
    seconds: float = 0.0
    on_done: Callable[[Change], None] | None = None
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

    def finish(self, error: ErrorInfo | None, seconds: float) -> None:
        """Its end."""
        self.error, self.seconds = error, seconds
        self._done.set()
        if self.on_done is not None:
            self.on_done(self)


class ChangeRunner:
    """Runs changes one after the other on the board."""

    def __init__(
        self,
        board: Board,
        tools: Tools,
        files: Files,
        configs: Callable[[], Mapping[str, Config]],
        throughput: Callable[[], Throughput],
    ) -> None:
        self._board = board
        self._throughput = throughput
        self._tools = tools
        self._files = files
        self._configs = configs

    def plan(self, goal: planning.Goal) -> planning.Plan:
        """What going there would do from here. Raises what is wrong with the files."""
        state = self._board.state
        return planning.make_plan(goal, state, self._config(state.config), self._files, self._throughput())

    def run(self, goal: planning.Goal, number: int, cancelled: Callable[[], bool]) -> planning.Plan:
        """Go there, or back to where the board was.

        Raises what the plan says is wrong (nothing was touched then), StepFailed (the board went back)
        or UndoFailed (regions stay decoupled).
        """
        before = self._board.state
        plan = self.plan(goal)
        transaction = Transaction(plan, self._board, self._tools, number, cancelled)
        try:
            transaction.run()
        except (CmError, OSError) as error:
            raise self._back(before, transaction, error, number) from error
        return plan

    def _back(self, before: BoardState, failed: Transaction, error: Exception, number: int) -> CmError:
        step = failed.current.text if failed.current else "the change"
        text, code = f"{step}: {error}", error.code if isinstance(error, CmError) else "device_error"
        old = self._config(before.config)
        try:
            if old is not None and before.mode in old.modes:
                self._restore(before, old, number)
                return StepFailed(f"{text}; the board is back in {before.config}/{before.mode}", code)
            return self._give_up(before, f"{text}; there was no mode to go back to", code)
        except (CmError, OSError) as second:
            given = self._give_up(before, f"{text}; going back failed too: {second}", code)
            return UndoFailed(str(given))
        finally:
            self._board.lock_regions(frozenset())

    def _restore(self, before: BoardState, old: Config, number: int) -> None:
        assert before.mode is not None
        back = self.plan(planning.Goal(old, before.mode, values=before.values))
        Transaction(back, self._board, self._tools, number, lambda: False).run()
        self._tools.data_plane.resume(old, before.mode)

    def _give_up(self, before: BoardState, text: str, code: str) -> StepFailed:
        """Leave what is not ready cut off, and say so."""
        regions = {r.name: r for c in self._configs().values() for r in c.regions.values()}
        touched = [r for name, r in regions.items() if name in self._board.state.regions]
        problems = abandon(self._board, self._tools.registers, touched)
        if not self._holds(before):
            self._board.update(lambda state: replace(state, mode=None))
        self._board.record(None)
        self._tools.data_plane.resume(self._config(before.config), self._board.state.mode)
        cut = [n for n, r in self._board.state.regions.items() if r.phase is RegionPhase.FAILED]
        tail = "; ".join([f"regions left decoupled: {', '.join(cut)}" if cut else "no region was touched", *problems])
        return StepFailed(f"{text}; {tail}", code)

    def _holds(self, mode: BoardState) -> bool:
        """Whether the regions still hold what they held in that mode."""
        now = self._board.state
        return all(now.region(name) == region for name, region in mode.regions.items())

    def _config(self, name: str | None) -> Config | None:
        return self._configs().get(name) if name else None
