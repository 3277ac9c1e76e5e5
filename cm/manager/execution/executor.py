# SPDX-License-Identifier: Apache-2.0
"""One change from its turn to its end, in the worker's thread; and `cm.manager.execution.board.Board` for its steps."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cm.errors import CmError
from cm.manager.access.leases import Leases
from cm.manager.access.register_service import Locked, RegisterDesk
from cm.manager.change import Change
from cm.manager.environment import Environment
from cm.manager.errors import Cancelled
from cm.manager.execution.board import Tools
from cm.manager.execution.runner import ChangeRunner
from cm.manager.loaders import Job
from cm.manager.planning import resolve
from cm.manager.planning.plan import Goal
from cm.manager.reporting.status import Teller
from cm.manager.state.board_state import Knowledge
from cm.manager.state.record import Pending
from cm.manager.state.steps import Step
from cm.manager.state.table import BoardState
from cm.messages.status import ErrorInfo, Progress
from cm.schema.model import Config, ConfigType, LoaderKind


@dataclass(frozen=True, slots=True)
class LiveBoard:
    """The board as the steps of a change see it."""

    known: Knowledge
    desk: RegisterDesk
    teller: Teller

    @property
    def state(self) -> BoardState:
        """What it holds now."""
        return self.known.state

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state in one piece."""
        self.known.update(change)

    def observed(self, kind: LoaderKind, length: int, seconds: float) -> None:
        """Keep a measurement."""
        self.known.observed(kind, length, seconds)

    def took(self, step: Step, seconds: float) -> None:
        """Keep how long a step took."""
        self.known.took(step.kind, seconds)

    def record(self, step: Step | None) -> None:
        """Write state and pending step to the store. Raises RecordFailed."""
        self.known.record(step)

    def lock_regions(self, regions: frozenset[str], whole: bool = False) -> None:
        """Keep requests off these regions' registers, or off all; waits for an access under way."""
        self.desk.keep_off(Locked(regions, whole))

    def progress(self, progress: Progress) -> None:
        """Publish how far the running change is."""
        self.teller.progress(progress)


class Executor:
    """Runs changes to their end; each ends once, whatever happens."""

    def __init__(self, board: LiveBoard, tools: Tools, env: Environment, leases: Leases) -> None:
        self._board = board
        self._known = board.known
        self._teller = board.teller
        self._tools = tools
        self._env = env
        self._leases = leases
        self._runner = ChangeRunner(
            board, tools, env.files, lambda: self._known.configs, lambda: self._known.throughput
        )
        self.plan = self._runner.plan

    def run(self, change: Change, released: Callable[[], None]) -> None:
        """Run a change and finish it; `released` is called when the next may be asked for."""
        started = self._env.clock.monotonic()
        self._known.pending = self._begun(change)
        error = self._outcome(change)
        seconds = self._env.clock.monotonic() - started
        self._known.pending = None
        self._teller.ended(change, error, seconds)
        self._board.lock_regions(frozenset())
        self._teller.note(self._known.try_record())
        released()
        self._teller.changed()
        change.finish(error, seconds)

    def _begun(self, change: Change) -> Pending:
        state = self._known.state
        whole = self._known.configs[change.config].type is ConfigType.FULL
        there = state.config == change.config and not change.force
        self._teller.begun(change, (whole and not there) or change.static is not None)
        return Pending(
            change.number, change.config, change.mode, state.config, state.mode, from_static=state.static_config
        )

    def _outcome(self, change: Change) -> ErrorInfo | None:
        try:
            self._take(change)
        except CmError as problem:
            return ErrorInfo(getattr(problem, "cause_code", problem.code), str(problem))
        except Exception as problem:  # noqa: BLE001 (a defect of ours must not end the worker)
            return ErrorInfo("internal", f"{type(problem).__name__}: {problem}")
        return None

    def _take(self, change: Change) -> None:
        if change.cancelled:
            raise Cancelled("the change was cancelled before it began")
        self._leases.check(change.scopes, change.lease)  # one may have been given while this change waited
        configs = self._known.configs
        config = configs[change.config]
        mode = resolve.mode_named(config, change.mode)  # it may have been provisioned anew while this change waited
        goal = Goal(config, mode, change.force, static=configs.get(change.static or ""))
        self._runner.run(goal, change.number, lambda: change.cancelled)

    def prefetch(self, go_on: Callable[[], bool]) -> None:
        """Hold the loaded configuration's images ready. What is wrong with them shows when they are used."""
        config = self._known.loaded_config() if self._env.settings.prefetch_bytes else None
        if config is None:
            return
        jobs = list(self._jobs(config, go_on))
        if go_on():
            with contextlib.suppress(CmError, OSError):
                self._tools.loaders.prefetch(jobs, go_on)

    def _jobs(self, config: Config, go_on: Callable[[], bool]) -> Iterator[Job]:
        for module in config.modules.values():
            if not go_on():
                return
            with contextlib.suppress(CmError, OSError):
                image = self._env.files.image(config, module)
                yield Job(config, image, config.regions[module.region], module)
