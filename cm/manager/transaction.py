# SPDX-License-Identifier: Apache-2.0
"""Takes the steps of a plan, recording each before it is taken.

A step that fails leaves the board where the record says; going back is another plan, made from that
state (`cm.manager.changes`), not a list of inverses: so the way back copes with whatever was reached.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Protocol

from cm.errors import CmError
from cm.manager import steps as s
from cm.manager.errors import Cancelled, IdentityMismatch, VerifyFailed
from cm.manager.loaders import Job, Loaders, loading_overlay
from cm.manager.plan import Plan
from cm.manager.ports import Clock, DataPlane, Devices
from cm.manager.registers import RegisterAccess
from cm.manager.state import BoardState, OverlayState, RegionEvent, RegionPhase, RegionState, all_lost
from cm.messages.status import Progress
from cm.schema.model import Access, Decoupler, LoaderKind, Region, Register


class Board(Protocol):
    """Where the state lives and is recorded; shared with readers of registers."""

    @property
    def state(self) -> BoardState:
        """What the board holds now."""

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state by what `change` makes of it, in one piece."""

    def observed(self, kind: LoaderKind, length: int, seconds: float) -> None:
        """A load of `length` bytes took so long."""

    def record(self, step: s.Step | None) -> None:
        """Write the state, and the step about to be taken, to the store."""

    def lock_regions(self, regions: frozenset[str], whole: bool = False) -> None:
        """From here on nobody else touches registers of these regions, or with `whole` any register."""

    def progress(self, progress: Progress) -> None:
        """Tell how far the change is."""


def drive(registers: RegisterAccess, decoupler: Decoupler, cut: bool) -> None:
    """Set a decoupler's bit and read it back: a region believed cut off must be. Raises VerifyFailed, DeviceError."""
    address, bit = decoupler.base_address + decoupler.offset, 1 << decoupler.bit
    before = registers.read_address(address, decoupler.width)
    wanted = before | bit if cut == decoupler.active_high else before & ~bit
    registers.write_address(address, decoupler.width, wanted)
    after = registers.read_address(address, decoupler.width)
    if (after ^ wanted) & bit:
        raise VerifyFailed(f"the decoupler at {address:#x} bit {decoupler.bit} reads {after:#x} after {wanted:#x}")


@dataclass(frozen=True, slots=True)
class Tools:
    """What the steps work with."""

    devices: Devices
    registers: RegisterAccess
    loaders: Loaders
    data_plane: DataPlane
    clock: Clock


class Transaction:
    """One run through a plan."""

    def __init__(self, plan: Plan, board: Board, tools: Tools, number: int, cancelled: Callable[[], bool]) -> None:
        self._plan = plan
        self._board = board
        self._tools = tools
        self._number = number
        self._cancelled = cancelled
        self._bytes_before = 0
        self._written: dict[str, int] = {}
        self.found: dict[str, int] = {}  # values that were there before, for the way back
        self.current: s.Step | None = None

    def run(self) -> None:
        """Take all steps. Raises what the failing step raised; `current` is that step."""
        for index, step in enumerate(self._plan.steps):
            self.current = step
            self._board.record(step)
            self._tell(step, index, 0)
            _TAKE[type(step)](self, step)
        self.current = None
        self._board.record(None)

    def _tell(self, step: s.Step, index: int, done: int) -> None:
        whole = self._plan.bytes
        fraction = (self._bytes_before + done) / whole if whole else index / len(self._plan.steps)
        goal = self._plan.goal
        image = step.image.length if isinstance(step, s.Load | s.LoadStatic) else 0
        self._board.progress(
            Progress(
                self._number, goal.config.name, goal.mode, step.kind, step.subject, done, image, min(fraction, 1.0)
            )
        )

    def _set_region(self, name: str, region: RegionState) -> None:
        self._board.update(lambda state: state.with_region(name, region))

    def _region_event(self, name: str, event: RegionEvent) -> None:
        self._set_region(name, self._board.state.region(name).after(event))

    def _check_cancelled(self) -> None:
        if self._cancelled():
            raise Cancelled("the change was cancelled")

    # ---- steps ----------------------------------------------------------------

    def _validate(self, _: s.Validate) -> None:
        """The planner has read and checked every image; what is left is to ask the ports, and to keep readers off."""
        for step in self._plan.steps:
            if isinstance(step, s.Load):
                self._tools.loaders.kind(step.region.loader).check(self._job(step))
            elif isinstance(step, s.LoadStatic):
                self._tools.loaders.kind(step.loader).check(self._job(step))
        regions = frozenset(x.region.name for x in self._plan.steps if isinstance(x, s.Decouple))
        self._board.lock_regions(regions, whole=self._plan.full)
        self._check_cancelled()

    def _quiesce(self, step: s.Quiesce) -> None:
        self._tools.data_plane.quiesce(step.streams)

    def _remove_overlay(self, step: s.RemoveOverlay) -> None:
        overlays = self._tools.devices.overlays()
        if step.name in overlays.list():
            overlays.remove(step.name)
        self._board.update(lambda x: replace(x, overlays=tuple(o for o in x.overlays if o.name != step.name)))
        self._tools.registers.forget()

    def _decouple(self, step: s.Decouple) -> None:
        self._region_event(step.region.name, RegionEvent.DECOUPLE)  # first: if it fails, it may be cut off
        if step.region.decoupler:
            drive(self._tools.registers, step.region.decoupler, cut=True)

    def _recouple(self, step: s.Recouple) -> None:
        if step.region.decoupler:
            drive(self._tools.registers, step.region.decoupler, cut=False)
        self._region_event(step.region.name, RegionEvent.RECOUPLE)

    def _job(self, step: s.Load | s.LoadStatic) -> Job:
        if isinstance(step, s.LoadStatic):
            return Job(self._plan.goal.config, step.image)
        return Job(self._plan.goal.config, step.image, step.region, step.module, step.overlay)

    def _load(self, step: s.Load) -> None:
        self._check_cancelled()
        name = step.region.name
        self._region_event(name, RegionEvent.LOAD)
        self._board.update(lambda state: state.without_values(set(step.resets)))
        try:
            self._board.record(step)
            self._timed_load(step, self._job(step), step.region.loader)
        except BaseException:
            self._region_event(name, RegionEvent.LOAD_FAILED)
            raise
        held = self._board.state.region(name).after(RegionEvent.LOAD_DONE)
        self._set_region(name, held.holding(step.module.name, step.image.sha256))
        if step.region.loader is LoaderKind.OVERLAY:
            self._applied(OverlayState(loading_overlay(name), step.image.sha256))

    def _load_static(self, step: s.LoadStatic) -> None:
        self._check_cancelled()
        self._board.update(all_lost)
        self._board.record(step)
        self._tools.registers.forget()
        self._timed_load(step, self._job(step), step.loader)
        self._board.update(
            lambda x: replace(x, static_sha256=step.image.sha256, static_config=step.config, static_lost=False)
        )

    def _timed_load(self, step: s.Load | s.LoadStatic, job: Job, kind: LoaderKind) -> None:
        index = self._plan.steps.index(step)
        started = self._tools.clock.monotonic()
        self._tools.loaders.kind(kind).load(job, step.timeout, lambda done: self._tell(step, index, done))
        seconds = self._tools.clock.monotonic() - started
        self._bytes_before += step.image.length
        self._board.observed(kind, step.image.length, seconds)

    def _apply_overlay(self, step: s.ApplyOverlay) -> None:
        overlays = self._tools.devices.overlays()
        if step.overlay.name in overlays.list():
            overlays.remove(step.overlay.name)
        overlays.apply(step.overlay.name, step.data)
        self._applied(OverlayState(step.overlay.name, step.sha256))

    def _applied(self, overlay: OverlayState) -> None:
        def put(state: BoardState) -> BoardState:
            others = (o for o in state.overlays if o.name != overlay.name)
            return replace(state, overlays=(*others, overlay))

        self._board.update(put)
        self._tools.registers.forget()

    def _check_identity(self, step: s.CheckIdentity) -> None:
        identity = step.region.identity
        if identity is None or step.module.identity is None:
            return
        value = self._tools.registers.read_address(identity.base_address + identity.offset, identity.width)
        if value != step.module.identity:
            self._region_event(step.region.name, RegionEvent.LOSE)  # it is coupled, but to what?
            raise IdentityMismatch(
                f"region {step.region.name} answers {value:#x} at its identity register; "
                f"module {step.module.name} is {step.module.identity:#x}"
            )

    def _set_register(self, step: s.SetRegister) -> None:
        register = step.register
        self._remember(register)
        self._tools.registers.write_address(register.address, register.width, step.value)
        self._board.update(lambda state: state.with_value(register.name, step.value))
        self._written[register.name] = step.value
        if register.access is not Access.RW or register.volatile:
            return
        value = self._tools.registers.read(register)
        if value != step.value:
            raise VerifyFailed(f"register {register.name} reads {value:#x} after {step.value:#x} was written")

    def _remember(self, register: Register) -> None:
        """What a register of the static part or of a region that stays held, where nobody wrote it yet."""
        loaded = {x.region.name for x in self._plan.steps if isinstance(x, s.Load)}
        known = register.name in self._board.state.values or register.region in loaded or self._plan.full
        if not known and register.access is Access.RW and not register.volatile:
            self.found[register.name] = self._tools.registers.read(register)

    def _publish(self, step: s.Publish) -> None:
        self._board.update(self._entered)
        self._board.record(None)
        self._board.lock_regions(frozenset())
        self._tools.data_plane.resume(self._plan.goal.config, step.mode)

    def _entered(self, state: BoardState) -> BoardState:
        """In another configuration the same names are other registers: only what was written here is known."""
        goal = self._plan.goal
        if state.config != goal.config.name:
            state = replace(state, values=MappingProxyType(dict(self._written)))
        return replace(state, config=goal.config.name, mode=goal.mode)


_TAKE: dict[type, Callable[[Transaction, Any], None]] = {
    s.Validate: Transaction._validate,
    s.Quiesce: Transaction._quiesce,
    s.RemoveOverlay: Transaction._remove_overlay,
    s.Decouple: Transaction._decouple,
    s.Load: Transaction._load,
    s.LoadStatic: Transaction._load_static,
    s.ApplyOverlay: Transaction._apply_overlay,
    s.Recouple: Transaction._recouple,
    s.CheckIdentity: Transaction._check_identity,
    s.SetRegister: Transaction._set_register,
    s.Publish: Transaction._publish,
}


def abandon(board: Board, registers: RegisterAccess, regions: Iterable[Region]) -> list[str]:
    """After a failed way back: cut off every region that is not ready.

    Returns a sentence for each that could not be cut off. A device that may not be configured is not
    accessed at all: its bus would not answer, and the processor would hang.
    """
    problems = []
    reachable = not board.state.static_lost
    for region in regions:
        state = board.state.region(region.name)
        if state.phase is RegionPhase.READY:
            continue
        try:
            if region.decoupler and reachable:
                drive(registers, region.decoupler, cut=True)
        except (CmError, OSError) as error:
            problems.append(f"{region.name} could not be decoupled: {error}")
        abandoned = state.after(RegionEvent.ABANDON)
        board.update(lambda x, name=region.name, to=abandoned: x.with_region(name, to))  # type: ignore[misc]
    return problems
