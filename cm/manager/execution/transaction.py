# SPDX-License-Identifier: Apache-2.0
"""The execution of a plan: what its steps work with, how far it is, each step recorded before it is taken.

What is done at each is one function per kind of step, and the table of them (`ACTIONS`).

A step that fails leaves the board where the record says. Going back is another plan, made from that state
(`cm.manager.execution.rollback`), not a list of inverses: so the way back works from whatever state was reached.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cm.errors import Busy, CmError
from cm.frozen import dataclass, field, replace
from cm.manager.access.register_bus import RegisterBus, drive, is_cut
from cm.manager.errors import Cancelled, IdentityMismatch, NoPort, NoSuchPlace, RecordFailed, VerifyFailed, WrongStatic
from cm.manager.loaders import Job, Loaders, Start, resolved
from cm.manager.planner import Goal, Plan, check_rate, just_above, make_plan, place_of
from cm.manager.state import steps as s
from cm.manager.state.board_state import (
    BoardState,
    OverlayState,
    RegionEvent,
    RegionPhase,
    RegionState,
    all_lost,
    loading_overlay,
)
from cm.manager.state.journal import ManagerState
from cm.manager.state.steps import Step
from cm.manager.status_reports import StatusReporter
from cm.manager.touched import emptied
from cm.schema.clock_rates import rate_problem
from cm.schema.model import Config, LoaderKind, Register
from cm.wire.messages.status import Progress, StepTaken

if TYPE_CHECKING:
    from cm.manager.interfaces import DataPlane, Devices, Files, TimeSource


@dataclass(frozen=True, slots=True)
class Tools:
    """What the steps of a change work with."""

    state: ManagerState
    reporter: StatusReporter
    devices: Devices
    registers: RegisterBus
    loaders: Loaders
    files: Files
    data_plane: DataPlane
    time: TimeSource
    take_back: Callable[[str, str], None]  # windows of what is locked, before a change to this configuration and mode


@dataclass(slots=True)
class StepContext:
    """A plan under execution: its tools, and how far it is.

    `best_effort` is for the way back, which continues even if its record cannot be written. The last good record then
    is of this change: after a crash the board goes to the same mode, and everything is loaded that this record does
    not say is there. Only a full image is not begun without a record, because registers of a half-loaded device must
    not be accessed.
    """

    plan: Plan
    tools: Tools
    number: int
    cancelled: Callable[[], bool]
    best_effort: bool = False
    at: int = -1  # index of the step that is being taken
    length: int = 0  # bytes of that step's image
    loaded: int = 0  # and of those of steps before it
    whole: int = 0  # and of all that go through a port
    port_seconds: float = 0.0  # that a port took for that step's image
    written: dict[str, int] = field(default_factory=dict)  # registers, by name
    found: dict[s.Place, int] = field(default_factory=dict)  # what registers held before, for the way back
    sealed: set[str] = field(default_factory=set)  # regions that are certainly isolated
    apart: set[str] = field(default_factory=set)  # regions of unknown content that were isolated before
    rates: dict[str, int] = field(default_factory=dict)  # what clocks ran at before, in Hz, for the way back

    @property
    def step(self) -> s.Step | None:
        """The step that is being taken; None before the first."""
        return self.plan.steps[self.at] if self.at >= 0 else None

    @property
    def board(self) -> BoardState:
        """What the board holds now."""
        return self.tools.state.board

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace what the board holds by what `change` makes of it, in one piece."""
        self.tools.state.update(change)

    def set_region(self, name: str, region: RegionState) -> None:
        """Replace a region's state."""
        self.update(lambda board: board.with_region(name, region))

    def region_event(self, name: str, event: RegionEvent) -> None:
        """Something happened to a region. Raises IllegalTransition."""
        self.set_region(name, self.board.region(name).after(event))

    def record(self, step: s.Step | None) -> None:
        """Write what the board holds, and the step about to be taken. Raises RecordFailed."""
        try:
            self.tools.state.record(step)
        except RecordFailed:
            if not self.best_effort or isinstance(step, s.LoadStatic):
                raise

    def check_cancelled(self) -> None:
        """Raise Cancelled if a client asked for it."""
        if self.cancelled():
            raise Cancelled("the change was cancelled")

    def tell(self, done: int) -> None:
        """Publish the step under way; `done` bytes of its image have gone through the port."""
        step, goal = self.plan.steps[self.at], self.plan.goal
        fraction = (self.loaded + done) / self.whole if self.whole else self.at / len(self.plan.steps)
        subject = step.subject, done, self.length, min(fraction, 1.0)
        self.tools.reporter.progress(Progress(self.number, goal.config.name, goal.mode, step.kind, *subject))


def plan_to(goal: Goal, tools: Tools, back: bool = False) -> Plan:
    """The plan from here to a goal; touches nothing. Raises what is wrong with the files, NoPort, and NoSuchPlace.

    `back`: it is the way back, of which as much is taken as can be.
    """
    plan = _planned(goal, tools)
    if not back:
        _check_places(plan, tools.registers)
    return plan


def _check_places(plan: Plan, registers: RegisterBus) -> None:
    """Look whether the board has the registers of the steps up to the first overlay, which may bring further ones."""
    for step in plan.steps:
        if isinstance(step, s.ApplyOverlay) or (isinstance(step, s.Load) and step.overlay):
            return
        for what, address, size in _places(step):
            try:
                registers.place(address, size)
            except CmError as error:
                raise NoSuchPlace(f"{what} of {plan.goal.config.name}, at {address:#x}: {error}") from error


def _places(step: Step) -> Iterator[tuple[str, int, int]]:
    """What a step accesses: what that is, its physical address, and its bytes."""
    if isinstance(step, s.SetRegister):
        yield f"register {step.register.name}", step.register.address, step.register.width // 8
    if isinstance(step, (s.Decouple, s.Recouple)) and (cut := step.region.decoupler) is not None and cut.size:
        yield f"the decoupler of region {step.region.name}", cut.base_address + cut.offset, cut.size
    if isinstance(step, s.CheckIdentity) and (own := step.region.identity) is not None:
        yield f"the identity of region {step.region.name}", own.base_address + own.offset, own.width // 8
    if isinstance(step, s.CheckStatic) and step.known and (there := step.static) and there.base_address is not None:
        yield "the identity of the static part", there.base_address + there.offset, there.width // 8


def _planned(goal: Goal, tools: Tools) -> Plan:
    state = tools.state
    modules = () if goal.unload else (*goal.config.modes[goal.mode].modules, *goal.also)
    wanted = {goal.config.modules[name].region for name in modules}
    try:
        config, choices = resolved(goal.config, wanted, tools.devices)
    except NoPort:
        plan = _plan(goal, resolved(goal.config, (), tools.devices)[0], tools)
        if not plan.then:  # otherwise the port may come with the overlays at its beginning
            raise
        return replace(plan, ports_later=True)
    state.choose(goal.config.name, choices)
    return _plan(goal, config, tools)


def _plan(goal: Goal, config: Config, tools: Tools) -> Plan:
    state = tools.state
    old = state.configs.get(state.board.config or "")
    return make_plan(replace(goal, config=config), state.board, old, tools.files, state.throughput, tools.devices)


def take_steps(run: StepContext, goal: Goal) -> None:
    """Record each step, then take it by its action.

    Raises what a step raised; `run.step` is that step. A plan that only adds the devices of the static part is followed
    by the one that they make possible.
    """
    _take_all(run)
    if run.plan.then:
        run.at = -1
        run.plan = plan_to(replace(goal, grounded=True), run.tools, back=run.best_effort)
        _take_all(run)


def _take_all(run: StepContext) -> None:
    run.loaded, run.whole = 0, run.plan.bytes
    for at, step in enumerate(run.plan.steps):
        run.at, run.length = at, step.length
        _carry_out(run, step, ACTIONS[type(step)])
        run.loaded += run.length


def _carry_out(run: StepContext, step: Step, action: Callable[[StepContext, Any], None]) -> None:
    time = run.tools.time
    started, run.port_seconds = time.monotonic(), 0.0
    failed = True
    try:
        run.record(step)
        run.tell(0)
        action(run, step)
        failed = False
    finally:
        seconds, what = time.monotonic() - started, (step.kind, step.subject, int(started * 1e9))
        run.tools.reporter.history.took(StepTaken(*what, seconds, run.port_seconds, failed, run.best_effort))
    run.tools.state.took(step.kind, seconds, run.port_seconds)


IDENTITY_READS = 1000  # each read takes longer than a clock cycle of the region, all of them longer than any reset


def job_of(step: s.Load | s.LoadStatic) -> Job:
    """What a loader is given for a step."""
    if isinstance(step, s.LoadStatic):
        return Job(step.image)
    return Job(step.image, step.region, step.overlay, step.region.loader_name)


def decouple(run: StepContext, step: s.Decouple) -> None:
    """Isolate; the state says so first: if this fails, the region may be isolated."""
    name, decoupler = step.region.name, step.region.decoupler
    unknown = run.board.region(name).phase is RegionPhase.UNKNOWN
    if decoupler and unknown and is_cut(run.tools.registers, decoupler):
        run.apart.add(name)
    run.region_event(name, RegionEvent.DECOUPLE)
    if decoupler:
        drive(run.tools.registers, decoupler, cut=True)
        run.sealed.add(name)


def recouple(run: StepContext, step: s.Recouple) -> None:
    """Connect; only then does the state say so. Its registers were reset: nothing is known of them."""
    run.update(lambda state: state.without_values(step.resets))
    run.sealed.discard(step.region.name)
    if step.region.decoupler:
        drive(run.tools.registers, step.region.decoupler, cut=False)
    run.region_event(step.region.name, RegionEvent.RECOUPLE)


def load(run: StepContext, step: s.Load) -> None:
    """Load one region; before the port is touched, what it held is forgotten, and that is recorded."""
    run.check_cancelled()
    name = step.region.name
    with run.tools.loaders.kind(step.port_kind).prepared(job_of(step), step.timeout) as start:
        _forget_content(run, step)
        try:
            _through(run, step, start)
        except BaseException:
            run.region_event(name, RegionEvent.LOAD_FAILED)
            raise
    run.tools.reporter.health.mended(name)
    held = run.board.region(name).after(RegionEvent.LOAD_DONE)
    run.set_region(name, held.holding(step.module.name, step.image.sha256))
    if step.region.loader is LoaderKind.OVERLAY:
        note_applied(run, OverlayState(loading_overlay(name), step.image.sha256))


def _through(run: StepContext, step: s.Load, start: Start) -> None:
    """Load through the step's port, or through the other one if that refuses before it has accepted anything."""
    state, config = run.tools.state, run.plan.goal.config.name
    try:
        _timed(run, step, start)
    except (Busy, PermissionError) as refused:
        loader, job, choice = run.tools.loaders.instead(job_of(step), state.configs[config], refused)
        with loader.prepared(job, step.timeout) as other:
            other(run.tell)
        state.choose(config, {step.region.name: choice})


def _forget_content(run: StepContext, step: s.Load) -> None:
    name = step.region.name
    before, noted = run.board.region(name), run.tools.state.pending
    run.region_event(name, RegionEvent.LOAD)
    run.tools.state.note_load(name)
    try:
        run.record(step)
    except BaseException:
        run.set_region(name, before)  # nothing was loaded
        run.tools.state.pending = noted
        raise


def load_static(run: StepContext, step: s.LoadStatic) -> None:
    """Load the whole device; everything that it held is forgotten first."""
    run.check_cancelled()
    with run.tools.loaders.kind(step.port_kind).prepared(job_of(step), step.timeout) as start:
        _forget_device(run, step)
        run.tools.registers.forget()
        _timed(run, step, start)
    run.update(lambda x: replace(x, static_sha256=step.image.sha256, static_config=step.config, static_lost=False))


def _forget_device(run: StepContext, step: s.LoadStatic) -> None:
    before = run.board
    run.update(all_lost)
    try:
        run.record(step)
    except BaseException:
        run.update(lambda _: before)  # nothing was loaded
        raise


def _timed(run: StepContext, step: s.Load | s.LoadStatic, start: Start) -> None:
    started = run.tools.time.monotonic()
    start(run.tell)
    run.port_seconds = run.tools.time.monotonic() - started
    run.tools.state.observed(step.port_kind, step.image.length, run.port_seconds)


def check_static(run: StepContext, step: s.CheckStatic) -> None:
    """The static part's identity register has to match the one that the modules were made with."""
    static = step.static
    if not step.known or static is None or static.base_address is None:
        return
    value = run.tools.registers.read_address(static.base_address + static.offset, static.width)
    if value != static.identity:
        raise WrongStatic(
            f"{step.config} was made with another static design than the device holds: "
            f"expected {static.identity:#x}, the board has {value:#x}; load the image that belongs to it"
        )


def check_identity(run: StepContext, step: s.CheckIdentity) -> None:
    """The region's identity register has to read what the schema says of the module.

    A region that has just been connected is still in reset for some clock cycles, and reads as 0.
    """
    identity = step.region.identity
    if identity is None or step.module.identity is None:
        return
    for _ in range(IDENTITY_READS):
        value = run.tools.registers.read_address(identity.base_address + identity.offset, identity.width)
        if value == step.module.identity:
            return
        if value:
            break
    run.region_event(step.region.name, RegionEvent.LOSE)  # it is coupled, but to what?
    raise IdentityMismatch(
        f"region {step.region.name} answers {value:#x} at its identity register; "
        f"module {step.module.name} is {step.module.identity:#x}"
    )


def validate(run: StepContext, _: s.Validate) -> None:
    """The planner has read and checked every image; what remains is to ask the ports, and to lock the regions.

    What clients have mapped of them is taken back here: from now on nobody but this change reaches them.
    """
    plan = run.plan
    for step in (*plan.steps, *(() if plan.ports_later else plan.then)):
        if isinstance(step, s.Load | s.LoadStatic):
            run.tools.loaders.kind(step.port_kind).check(job_of(step))
    run.tools.state.lock_regions(plan.regions, whole=plan.full)
    run.tools.take_back(plan.goal.config.name, plan.goal.mode)
    run.check_cancelled()


def quiesce(run: StepContext, step: s.Quiesce) -> None:
    """When this returns no transfer of these streams is under way."""
    run.tools.data_plane.quiesce(step.streams)


def set_register(run: StepContext, step: s.SetRegister) -> None:
    """Write a register and, where it can be, read it back. Raises VerifyFailed."""
    register = step.register
    _remember(run, register)
    run.tools.registers.write_address(register.address, register.width, step.value)
    if not step.restores:
        _note(run, register, step.value)
    if not register.keeps:
        return
    value = run.tools.registers.read(register)
    if value != step.value:
        raise VerifyFailed(f"register {register.name} reads {value:#x} after {step.value:#x} was written")


def _note(run: StepContext, register: Register, value: int) -> None:
    """Note a written value; until the end of the change, names are those of the configuration before it."""
    run.written[register.name] = value
    if run.board.config in (None, run.plan.goal.config.name):
        run.tools.state.note_written(register.name, value)
    else:
        run.update(lambda board: board.without_values(_names_before(run, register)))


def _names_before(run: StepContext, register: Register) -> set[str]:
    """The name that the configuration before has for a register."""
    config = run.tools.state.loaded_config()
    if config is None:
        return set()
    seen = (r for mode in config.modes for r in config.visible_registers(mode).values())
    return {r.name for r in seen if place_of(r) == place_of(register)}


def _remember(run: StepContext, register: Register) -> None:
    """What a register of the static part or of a region that stays held, if it has not been written yet."""
    if register.region in run.plan.regions or run.plan.full or not register.keeps:
        return
    same = run.board.config == run.plan.goal.config.name
    names = {register.name} if same else _names_before(run, register)
    place = place_of(register)
    if any(run.tools.state.written_value(name) is not None for name in names):
        return
    if place in run.found or place in run.plan.goal.found:
        return
    value = run.tools.registers.read(register)
    run.found[place] = value
    run.tools.state.note_found(place, value)
    run.record(run.step)  # a kill between the write and the next step must not lose it


def repair(run: StepContext, step: s.Repair) -> None:
    """Write frames anew. One that is written with what it holds already changes nothing (docs/readback.md).

    If it fails, nobody knows what these frames hold: the region's content is not trusted.
    """
    run.check_cancelled()
    try:
        run.tools.loaders.write(step.region, step.words, step.image, step.timeout)
    except BaseException:
        run.tools.state.note_load(step.region.name)
        run.region_event(step.region.name, RegionEvent.LOSE)
        raise


def publish(run: StepContext, step: s.Publish) -> None:
    """The board is in the mode: record it, and release registers and streams.

    Without that record a restart would go back to the mode before, so the change fails and does that itself. Raises
    RecordFailed.
    """
    run.update(lambda state: _entered(state, run.plan.goal, run.written))
    run.record(None)
    run.tools.state.release_regions()
    run.tools.data_plane.resume(run.plan.goal.config, step.mode or None, run.tools.state.board.modules)


def _entered(state: BoardState, goal: Goal, written: dict[str, int]) -> BoardState:
    """In another configuration the same names are other registers: only values that this change wrote are known."""
    if state.config != goal.config.name:
        state = replace(state, values=MappingProxyType(dict(written)))
    for name in emptied(goal.config, goal.unload) if goal.unload else ():
        state = state.without_values(goal.config.registers_of(name)).with_region(
            name, RegionState(RegionPhase.DECOUPLED)
        )
    return replace(state, config=goal.config.name, mode=goal.mode or None, schema=goal.config.sha256_source)


def set_clock(run: StepContext, step: s.SetClock) -> None:
    """Set a clock, keep it running, and read back its rate, since rates are rounded without an error.

    Raises ClockRate if that is not near enough, DeviceError.
    """
    name = step.clock.name
    if not step.before:
        run.update(lambda board: board.with_clock(name, 0))
        return
    clock = run.tools.devices.clocks().find(name)
    run.rates[name] = step.before
    if clock.rate != step.clock.rate:
        clock.rate = step.asked or step.clock.rate
    if not step.running:
        clock.enabled = True
    if step.achieved is None and rate_problem(step.clock, clock.rate):  # a driver that cannot be asked, rounding down
        clock.rate = just_above(step.clock)
    rate = clock.rate
    run.update(lambda board: board.with_clock(name, rate))
    if not step.restores:
        check_rate(step.clock, rate)


def remove_overlay(run: StepContext, step: s.RemoveOverlay) -> None:
    """Take an overlay off, if it is still there."""
    overlays = run.tools.devices.overlays()
    if overlays.has(step.name):
        overlays.remove(step.name)
    run.update(lambda state: _without(state, step.name))
    run.tools.registers.forget()


def apply_overlay(run: StepContext, step: s.ApplyOverlay) -> None:
    """Put an overlay on, in place of a leftover one with its name."""
    overlays = run.tools.devices.overlays()
    if overlays.has(step.overlay.name):
        overlays.remove(step.overlay.name)
    overlays.apply(step.overlay.name, step.data)
    note_applied(run, OverlayState(step.overlay.name, step.sha256))


def note_applied(run: StepContext, overlay: OverlayState) -> None:
    """An overlay is on, the newest of all."""

    def on_top(state: BoardState) -> BoardState:
        return replace(state, overlays=(*_without(state, overlay.name).overlays, overlay))

    run.update(on_top)
    run.tools.registers.forget()


def _without(state: BoardState, name: str) -> BoardState:
    return replace(state, overlays=tuple(o for o in state.overlays if o.name != name))


ACTIONS: Mapping[type, Callable[[StepContext, Any], None]] = MappingProxyType(
    {
        s.Validate: validate,
        s.CheckStatic: check_static,
        s.Quiesce: quiesce,
        s.RemoveOverlay: remove_overlay,
        s.Decouple: decouple,
        s.Load: load,
        s.LoadStatic: load_static,
        s.ApplyOverlay: apply_overlay,
        s.Recouple: recouple,
        s.CheckIdentity: check_identity,
        s.SetRegister: set_register,
        s.SetClock: set_clock,
        s.Repair: repair,
        s.Publish: publish,
    }
)
