# SPDX-License-Identifier: Apache-2.0
"""After a failed step: go back to the mode before, or isolate what is not whole and say so.

Going back is a plan from wherever the board is now, like any other change.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Iterable, Mapping

from cm.errors import CmError
from cm.frozen import dataclass, replace
from cm.manager.access.register_bus import drive
from cm.manager.errors import RecordFailed, StaticUnknown, StepFailed, UndoFailed
from cm.manager.execution.transaction import StepContext, Tools
from cm.manager.planner import Goal
from cm.manager.state.board_state import BoardState, RegionEvent, RegionPhase
from cm.manager.state.steps import Place, Step, hertz
from cm.schema.model import Config, ConfigType, Region

_CUT = (RegionPhase.DECOUPLED, RegionPhase.LOADED)


@dataclass(frozen=True, slots=True)
class Failure:
    """What went wrong on the way to a configuration, at which step, and what was there before it.

    `values` and `found` are registers' values, by name and by place, `rates` what clocks ran at (Hz). `touched` are
    regions whose load had begun, or that were isolated before; `written` the registers that the change itself wrote.
    """

    goal: Config
    step: Step | None
    error: Exception
    values: Mapping[str, int]
    found: Mapping[Place, int]
    rates: Mapping[str, int]
    touched: frozenset[str]
    written: frozenset[str]

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
    """An error as a sentence; a defect of ours with its type."""
    return str(error) if isinstance(error, (CmError, OSError)) else f"{type(error).__name__}: {error}"


def failure_of(run: StepContext, error: Exception) -> Failure:
    """What is known about a failed step, for the way back."""
    goal = run.plan.goal
    values, found, rates = goal.values, {**run.found, **goal.found}, {**run.rates, **goal.rates}
    begun = run.tools.state.pending.begun if run.tools.state.pending else ()
    touched, written = frozenset({*begun, *run.apart}), frozenset(run.written)
    return Failure(goal.config, run.step, error, values, found, rates, touched, written)


class Rollback:
    """From where a failed change left the board to where it was `before`."""

    def __init__(
        self, tools: Tools, before: BoardState, go_to: Callable[[Goal], None], sealed: Collection[str]
    ) -> None:
        """`go_to` plans and takes the steps to a goal as far as possible; `sealed` as in StepContext."""
        self._sealed = sealed
        self._tools = tools
        self._state = tools.state
        self._configs = tools.state.configs
        self._before = before
        self._go_to = go_to

    def run(self, failure: Failure) -> CmError:
        """Go back, or isolate; returns the error that says how it ended."""
        before, old, cut = self._before, self._old, self._state.pending
        try:
            if cut is not None and not cut.touched:
                return StepFailed(f"{failure.text}; nothing was touched", failure.code)
            if old is not None and before.mode is not None and before.mode in old.modes:
                self._restore(old, before.mode, failure)
                tail = "; ".join([f"the board is back in {before.config}/{before.mode}", *self._tidy(failure)])
                return StepFailed(f"{failure.text}; {tail}", failure.code)
            end = self._give_up(failure)
            return StepFailed(f"{failure.text}; there was no mode to go back to; {end}", failure.code)
        except Exception as second:  # noqa: BLE001 (a defect of ours must not leave the region coupled either)
            end = self._give_up(failure)
            return UndoFailed(f"{failure.text}; going back failed too: {sentence(second)}; {end}")
        finally:
            self._state.release_regions()

    @property
    def _old(self) -> Config | None:
        return self._configs.get(self._before.config or "")

    def _restore(self, old: Config, mode: str, failure: Failure) -> None:
        static = self._static_to_load(old)
        by_clients = self._state.board.values_since(self._before, failure.written)
        values = {**failure.values, **self._before.values, **by_clients}
        also = self._beside(old, mode)
        self._go_to(Goal(old, mode, False, values, also, static, failure.rates, failure.found))
        self._tools.data_plane.resume(old, mode, self._state.board.modules)

    def _beside(self, old: Config, mode: str) -> tuple[str, ...]:
        """Modules of regions that the mode leaves alone, but that the failed change did not."""
        now, named = self._state.board, {old.modules[m].region for m in old.modes[mode].modules}
        lost = {
            held.module: name
            for name, held in self._before.regions.items()
            if held.phase is RegionPhase.READY and name not in named and now.region(name) != held
        }
        return tuple(m.name for m in old.modules.values() if lost.get(m.name) == m.region)

    def _tidy(self, failure: Failure) -> list[str]:
        """Handle regions that the mode before leaves alone and that the failed change has isolated.

        Those that still hold a module of another configuration, or what the boot loader loaded, are connected again;
        the rest stays isolated. Returns sentences about what is not as it was.
        """
        cut = [r for r in failure.goal.regions.values() if self._is_cut(r.name)]
        lost = [r for r in cut if not self._coupled_again(r, failure)]
        problems = isolate(self._tools, lost, self._sealed)
        return [*([f"regions left decoupled: {', '.join(r.name for r in lost)}"] if lost else []), *problems]

    def _is_cut(self, name: str) -> bool:
        return self._state.board.region(name).phase in _CUT and not self._was_empty(name)

    def _was_empty(self, name: str) -> bool:
        """Whether a region was unloaded before, and still is."""
        return self._before.region(name).empty and self._state.board.region(name).empty

    def _coupled_again(self, region: Region, failure: Failure) -> bool:
        """Connect a region again that was connected and still holds the same."""
        if not self._holds_still(region.name, failure) or not self._same_static():
            return False
        held = self._before.region(region.name)
        try:
            if region.decoupler:
                drive(self._tools.registers, region.decoupler, cut=False)
        except (CmError, OSError):
            return False
        self._state.update(lambda state: state.with_region(region.name, held))
        return True

    def _holds_still(self, name: str, failure: Failure) -> bool:
        held, now = self._before.region(name), self._state.board.region(name)
        if held.phase is RegionPhase.READY:
            return held.sha256 is not None and now.sha256 == held.sha256
        return held.phase is RegionPhase.UNKNOWN and name not in failure.touched

    def _static_to_load(self, old: Config) -> Config | None:
        """The full configuration to load first, if a partial one ran on it.

        Raises StaticUnknown if the image before was the boot loader's and is gone.
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

    def _give_up(self, failure: Failure) -> str:
        """Leave what is not ready isolated; returns a sentence on what each region holds."""
        before, same = self._before, self._same_static()
        known = [r for name, r in self._regions(failure.goal).items() if name in self._state.board.regions]
        again = {r.name for r in known if self._is_cut(r.name) and self._coupled_again(r, failure)}
        left = [r for r in known if r.name not in again and not self._was_empty(r.name)]
        problems = isolate(self._tools, left, self._sealed)
        if same:  # otherwise the rates are those of the image that is there now
            problems += self._rates_again(failure.rates)
        mode = before.mode if self._holds_as_before() else None
        config = before.config if same else None
        self._state.update(lambda state: replace(state, config=config, mode=mode, schema=before.schema))
        try:
            self._state.record(None)
        except RecordFailed as error:
            problems.append(str(error))
        self._tools.data_plane.resume(self._old, mode, self._state.board.modules)
        return "; ".join([self._left_sentence(), *problems])

    def _rates_again(self, rates: Mapping[str, int]) -> list[str]:
        """Set clocks to their former rates; returns a sentence for each that cannot be."""
        problems: list[str] = []
        clocks = self._tools.devices.clocks()
        for name, rate in rates.items():
            try:
                clock = clocks.find(name)
                clock.rate = rate
                there = clock.rate
            except (CmError, OSError) as error:
                problems.append(f"clock {name} could not be set back to {hertz(rate)}: {error}")
            else:
                self._state.update(functools.partial(BoardState.with_clock, name=name, rate=there))
        return problems

    def _regions(self, goal: Config) -> dict[str, Region]:
        """Regions by name, of both configurations that the device may be in."""
        old = self._old
        return {**(old.regions if old is not None and self._same_static() else {}), **goal.regions}

    def _left_sentence(self) -> str:
        """What a failed change left, as the record has it."""
        state = self._state.board
        again = [name for name in (self._state.pending.begun if self._state.pending else ()) if name in state.regions]
        if state.static_lost:
            return "what the device holds is not known, so nothing in it is accessed"
        cut = [name for name, region in state.regions.items() if region.phase is RegionPhase.FAILED]
        cut += [name for name in again if state.region(name).empty]
        if cut:
            return f"regions left decoupled: {', '.join(cut)}"
        if not self._same_static():
            return f"the device holds the image of {state.static_config}, and is in no mode"
        if not self._holds_as_before():
            return "what was loaded stays, in no mode"
        return f"loaded again with what they held before: {', '.join(again)}" if again else "no region was loaded"

    def _same_static(self) -> bool:
        now, before = self._state.board, self._before
        return (now.static_sha256, now.static_lost) == (before.static_sha256, before.static_lost)

    def _holds_as_before(self) -> bool:
        """Whether the regions still hold what they held before."""
        now, before = self._state.board, self._before
        return self._same_static() and all(
            now.region(name) == before.region(name) for name in {*before.regions, *now.regions}
        )


def isolate(tools: Tools, regions: Iterable[Region], sealed: Collection[str]) -> list[str]:
    """After a failed rollback: isolate every region that is not ready.

    Returns a sentence for each that could not be isolated; unless such a region is known to be isolated already, its
    content then counts as unknown. A device that may not be configured is not accessed: the processor would hang.
    """
    problems = []
    for region in [] if tools.state.board.static_lost else regions:
        if tools.state.board.region(region.name).phase is RegionPhase.READY:
            continue
        event = RegionEvent.ISOLATE
        try:
            if region.decoupler:
                drive(tools.registers, region.decoupler, cut=True)
        except (CmError, OSError) as error:
            problems.append(f"{region.name} could not be decoupled: {error}")
            there = region.name in sealed or tools.state.board.region(region.name).phase is RegionPhase.FAILED
            event = RegionEvent.ISOLATE if there else RegionEvent.LOSE
        _after(tools, region.name, event)
    return problems


def _after(tools: Tools, name: str, event: RegionEvent) -> None:
    tools.state.update(lambda board: board.with_region(name, board.region(name).after(event)))
