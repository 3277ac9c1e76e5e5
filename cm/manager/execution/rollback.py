# SPDX-License-Identifier: Apache-2.0
"""After a failed step: back to the mode before, or cut off what is not whole and say so.

Going back is a plan from wherever the board is now, like any other change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from cm.errors import CmError
from cm.manager.access.decoupler import drive
from cm.manager.errors import RecordFailed, StaticUnknown, StepFailed, UndoFailed
from cm.manager.execution.best_effort import BestEffort
from cm.manager.execution.board import Board, Tools
from cm.manager.execution.isolate import abandon
from cm.manager.execution.transaction import Transaction
from cm.manager.planning.plan import Goal, Plan
from cm.manager.state.steps import Step
from cm.manager.state.table import BoardState, RegionPhase
from cm.schema.model import Config, ConfigType, Region

_CUT = (RegionPhase.DECOUPLED, RegionPhase.LOADED)


@dataclass(frozen=True, slots=True)
class Failure:
    """What went wrong on the way to a configuration, at which step, and what registers had held before it."""

    goal: Config
    step: Step | None
    error: Exception
    found: Mapping[str, int]

    @property
    def code(self) -> str:
        """The stable code of the cause."""
        if isinstance(self.error, CmError):
            return self.error.code
        return "device_error" if isinstance(self.error, OSError) else "internal"

    @property
    def text(self) -> str:
        """The step and the cause."""
        return f"{self.step.text if self.step else 'the change'}: {sentence(self.error)}"


def sentence(error: Exception) -> str:
    """An error for people; one that is a defect of ours with its type."""
    return str(error) if isinstance(error, (CmError, OSError)) else f"{type(error).__name__}: {error}"


class WayBack:
    """From where a failed change left the board to where it was `before`."""

    def __init__(
        self,
        board: Board,
        tools: Tools,
        plan: Callable[[Goal], Plan],
        configs: Mapping[str, Config],
        before: BoardState,
        number: int,
    ) -> None:
        self._board = board
        self._tools = tools
        self._plan = plan
        self._configs = configs
        self._before = before
        self._number = number

    def go(self, failure: Failure) -> CmError:
        """Go back, or cut off; returns the error that tells how it ended."""
        before, old = self._before, self._old
        try:
            if old is not None and before.mode is not None and before.mode in old.modes:
                self._restore(old, before.mode, {**failure.found, **before.values})
                tail = "; ".join([f"the board is back in {before.config}/{before.mode}", *self._tidy(failure.goal)])
                return StepFailed(f"{failure.text}; {tail}", failure.code)
            end = self._give_up(failure.goal)
            return StepFailed(f"{failure.text}; there was no mode to go back to; {end}", failure.code)
        except Exception as second:  # noqa: BLE001 (a defect of ours must not leave the region coupled either)
            end = self._give_up(failure.goal)
            return UndoFailed(f"{failure.text}; going back failed too: {sentence(second)}; {end}")
        finally:
            self._board.lock_regions(frozenset())

    @property
    def _old(self) -> Config | None:
        return self._configs.get(self._before.config or "")

    def _restore(self, old: Config, mode: str, values: Mapping[str, int]) -> None:
        static = self._static_to_load(old)
        back = self._plan(Goal(old, mode, values=values, also=self._beside(old, mode), static=static))
        board = BestEffort(self._board)
        Transaction(back, board, self._tools, self._number, lambda: False).run()
        self._tools.data_plane.resume(old, mode)

    def _beside(self, old: Config, mode: str) -> tuple[str, ...]:
        """Modules of regions that the mode leaves alone, but that the failed change did not."""
        now, named = self._board.state, {old.modules[m].region for m in old.modes[mode].modules}
        lost = {
            held.module: name
            for name, held in self._before.regions.items()
            if held.phase is RegionPhase.READY and name not in named and now.region(name) != held
        }
        return tuple(m.name for m in old.modules.values() if lost.get(m.name) == m.region)

    def _tidy(self, goal: Config) -> list[str]:
        """Regions that the mode before leaves alone and that the failed change has cut off.

        What another configuration had loaded there, and is there still, is coupled again; the rest stays
        cut off. Returns sentences on what is not as it was.
        """
        cut = [r for r in goal.regions.values() if self._board.state.region(r.name).phase in _CUT]
        lost = [r for r in cut if not self._coupled_again(r)]
        problems = abandon(self._board, self._tools.registers, lost)
        return [*([f"regions left decoupled: {', '.join(r.name for r in lost)}"] if lost else []), *problems]

    def _coupled_again(self, region: Region) -> bool:
        held, now = self._before.region(region.name), self._board.state.region(region.name)
        if held.phase is not RegionPhase.READY or held.sha256 is None or now.sha256 != held.sha256:
            return False
        try:
            if region.decoupler:
                drive(self._tools.registers, region.decoupler, cut=False)
        except (CmError, OSError):
            return False
        self._board.update(lambda state: state.with_region(region.name, held))
        return True

    def _static_to_load(self, old: Config) -> Config | None:
        """The full configuration to load first, where the device held one under a partial configuration.

        Raises StaticUnknown where the one before was the boot loader's and is gone.
        """
        if old.type is ConfigType.FULL or self._same_static():
            return None
        static = self._configs.get(self._before.static_config or "")
        if static is None:
            raise StaticUnknown(
                f"the static part that {old.name} was running in is gone, and it is not the manager's to load: "
                "load a full configuration, or restart the board"
            )
        return static

    def _give_up(self, goal: Config) -> str:
        """Leave what is not ready cut off; says what is where."""
        before, same = self._before, self._same_static()
        touched = [r for name, r in self._regions(goal).items() if name in self._board.state.regions]
        problems = abandon(self._board, self._tools.registers, touched)
        mode = before.mode if self._holds_as_before() else None
        self._board.update(lambda state: replace(state, config=before.config if same else None, mode=mode))
        try:
            self._board.record(None)
        except RecordFailed as error:
            problems.append(str(error))
        self._tools.data_plane.resume(self._old, mode)
        return "; ".join([self._left(), *problems])

    def _regions(self, goal: Config) -> dict[str, Region]:
        """Regions by name as the two configurations have them that the device may be in."""
        old = self._old
        return {**(old.regions if old is not None and self._same_static() else {}), **goal.regions}

    def _left(self) -> str:
        state = self._board.state
        if state.static_lost:
            return "what the device holds is not known, so nothing in it is accessed"
        cut = [name for name, region in state.regions.items() if region.phase is RegionPhase.FAILED]
        if cut:
            return f"regions left decoupled: {', '.join(cut)}"
        if not self._same_static():
            return f"the device holds the image of {state.static_config}, and is in no mode"
        return "no region was touched" if self._holds_as_before() else "what was loaded stays, in no mode"

    def _same_static(self) -> bool:
        now, before = self._board.state, self._before
        return (now.static_sha256, now.static_lost) == (before.static_sha256, before.static_lost)

    def _holds_as_before(self) -> bool:
        """Whether the regions still hold what they held before."""
        now, before = self._board.state, self._before
        return self._same_static() and all(
            now.region(name) == before.region(name) for name in {*before.regions, *now.regions}
        )
