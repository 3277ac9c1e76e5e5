# SPDX-License-Identifier: Apache-2.0
"""A change of mode from request to end: plan, run, and go back when it fails."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from cm.errors import CmError
from cm.manager import plan as planning
from cm.manager.cost import Throughput
from cm.manager.errors import StaticUnknown, StepFailed, UndoFailed
from cm.manager.ports import Files
from cm.manager.state import BoardState, RegionPhase
from cm.manager.transaction import Board, Tools, Transaction, abandon
from cm.messages.status import ErrorInfo
from cm.schema.model import Config, ConfigType, Region


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
        except Exception as error:
            raise self._back(before, goal.config, transaction, error, number) from error
        return plan

    def _back(self, before: BoardState, goal: Config, failed: Transaction, error: Exception, number: int) -> CmError:
        step = failed.current.text if failed.current else "the change"
        text, code = f"{step}: {_sentence(error)}", _code(error)
        old = self._config(before.config)
        try:
            if old is not None and before.mode in old.modes:
                self._restore(before, old, {**failed.found, **before.values}, number)
                return StepFailed(f"{text}; the board is back in {before.config}/{before.mode}", code)
            return self._give_up(before, goal, f"{text}; there was no mode to go back to", code)
        except Exception as second:  # noqa: BLE001 (as above)
            given = self._give_up(before, goal, f"{text}; going back failed too: {_sentence(second)}", code)
            return UndoFailed(str(given))
        finally:
            self._board.lock_regions(frozenset())

    def _restore(self, before: BoardState, old: Config, values: Mapping[str, int], number: int) -> None:
        assert before.mode is not None
        goal = planning.Goal(old, before.mode, values=values, static=self._static_of(before, old))
        back = self.plan(goal)
        Transaction(back, self._board, self._tools, number, lambda: False).run()
        self._tools.data_plane.resume(old, before.mode)

    def _static_of(self, before: BoardState, old: Config) -> Config | None:
        """The full configuration to load first, where the device held one under a partial configuration.

        Raises StaticUnknown where the one before was the boot loader's and is gone.
        """
        if old.type is ConfigType.FULL or self._same_static(before):
            return None
        static = self._config(before.static_config)
        if static is None:
            raise StaticUnknown(
                f"the static part that {old.name} was running in is gone, and it is not the manager's to load: "
                "load a full configuration, or restart the board"
            )
        return static

    def _give_up(self, before: BoardState, goal: Config, text: str, code: str) -> StepFailed:
        """Leave what is not ready cut off, and say so."""
        touched = [r for name, r in self._regions(before, goal).items() if name in self._board.state.regions]
        problems = abandon(self._board, self._tools.registers, touched)
        mode = before.mode if self._holds(before) else None
        config = before.config if self._same_static(before) else None
        self._board.update(lambda state: replace(state, config=config, mode=mode))
        try:
            self._board.record(None)
        except OSError as error:
            problems.append(f"the state record could not be written: {error}")
        self._tools.data_plane.resume(self._config(before.config), self._board.state.mode)
        tail = "; ".join([self._left(before), *problems])
        return StepFailed(f"{text}; {tail}", code)

    def _regions(self, before: BoardState, goal: Config) -> dict[str, Region]:
        """Regions by name as the two configurations have them that the device may be in."""
        old = self._config(before.config)
        return {**(old.regions if old is not None and self._same_static(before) else {}), **goal.regions}

    def _left(self, before: BoardState) -> str:
        state = self._board.state
        if state.static_lost:
            return "what the device holds is not known, so nothing in it is accessed"
        cut = [name for name, region in state.regions.items() if region.phase is RegionPhase.FAILED]
        if cut:
            return f"regions left decoupled: {', '.join(cut)}"
        if not self._same_static(before):
            return f"the device holds the image of {state.static_config}, and is in no mode"
        return "no region was touched" if self._holds(before) else "what was loaded stays, in no mode"

    def _same_static(self, before: BoardState) -> bool:
        now = self._board.state
        return (now.static_sha256, now.static_lost) == (before.static_sha256, before.static_lost)

    def _holds(self, mode: BoardState) -> bool:
        """Whether the regions still hold what they held in that mode."""
        now = self._board.state
        return self._same_static(mode) and all(
            now.region(name) == mode.region(name) for name in {*mode.regions, *now.regions}
        )

    def _config(self, name: str | None) -> Config | None:
        return self._configs().get(name) if name else None


def _code(error: Exception) -> str:
    if isinstance(error, CmError):
        return error.code
    return "device_error" if isinstance(error, OSError) else "internal"


def _sentence(error: Exception) -> str:
    return str(error) if isinstance(error, (CmError, OSError)) else f"{type(error).__name__}: {error}"
