# SPDX-License-Identifier: Apache-2.0
"""From what the board holds and a goal to the steps between them; touches nothing.

The order is that of the design: validate, quiesce, decouple, load, overlays, registers, verify, recouple, publish —
with three deviations that the hardware requires. Overlays that go are removed before their region is cut off (their
drivers talk to it). A configuration's own overlays come first of all: they bring the devices that the other steps need,
and the plan ends there until these exist. A module's own registers and its identity lie behind the decoupler (PG375),
so they are written and checked after recoupling, while the streams are still stopped."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from cm.errors import InvalidRequest
from cm.frozen import dataclass, field, replace
from cm.hashes import sha256
from cm.manager.errors import (
    ClockRate,
    NothingLoaded,
    StaticUnknown,
    StepTimeout,
    UnknownConfig,
    UnknownMode,
    UnknownRegion,
    hint,
    listed,
)
from cm.manager.inputs import Image
from cm.manager.state import steps as s
from cm.manager.state.board_state import BoardState, OverlayState, RegionPhase, loading_overlay
from cm.manager.state.journal import Throughput
from cm.manager.state.steps import ApplyOverlay, Place, SetClock, SetRegister
from cm.manager.touched import emptied
from cm.schema.clock_rates import allowed, rate_problem
from cm.schema.model import Access, Clock, Config, ConfigType, LoaderKind, Mode, Module, Region, Register
from cm.wire.messages.requests import WHOLE, ChangeMode
from cm.wire.messages.status import ClockStatus, PlanInfo, PlanStep

if TYPE_CHECKING:
    from cm.manager.interfaces import Devices, Files, PlClock


def target(request: ChangeMode, configs: Mapping[str, Config], loaded: str | None) -> tuple[Config, str]:
    """Where a request goes. Raises UnknownConfig, UnknownMode, NothingLoaded with what there is.

    That a word may also name a module is the convenience of the paper's plain text, and of nothing else.
    """
    if request.unload:
        return _loaded_to_unload(request, configs, loaded), ""
    if request.name_or_mode:
        return _word(request.name_or_mode, configs, loaded)
    if request.config_name:
        config = config_named(request.config_name, configs)
    elif loaded is not None:
        config = configs[loaded]
    else:
        raise NothingLoaded(f"nothing is loaded: name a configuration ({listed(configs)})")
    return config, mode_of(config, request.mode) if request.mode else config.first_mode()


def _loaded_to_unload(request: ChangeMode, configs: Mapping[str, Config], loaded: str | None) -> Config:
    if request.mode or request.name_or_mode or request.force or request.undo or request.undoable:
        raise InvalidRequest("unload goes to no mode: it comes without a mode, force, undo and undoable")
    if loaded is None or request.config_name not in ("", loaded):
        raise NothingLoaded(f"{request.config_name or 'no configuration'} is not loaded: there is nothing to unload")
    if request.unload != WHOLE:
        check_region(configs[loaded], request.unload)
    return configs[loaded]


def check_region(config: Config, name: str) -> None:
    """Raise UnknownRegion where a configuration has no region of that name."""
    if name not in config.regions:
        raise UnknownRegion(f"configuration {config.name!r} has no region {name!r}{hint(name, config.regions)}")


def mode_left(config: Config, mode: str | None, unload: str) -> str:
    """The mode in which the board is without what is unloaded: the same if that was none of it, else none."""
    there = config.modes.get(mode or "")
    if unload == WHOLE or there is None or any(config.modules[name].region == unload for name in there.modules):
        return ""
    return there.name


def config_named(name: str, configs: Mapping[str, Config]) -> Config:
    """A configuration by name."""
    config = configs.get(name)
    if config is None:
        raise UnknownConfig(f"no configuration {name!r}{hint(name, configs)}")
    return config


def mode_of(config: Config, name: str) -> str:
    """A mode by its name alone. Raises UnknownMode."""
    if name in config.modes:
        return name
    alone = [f"; mode {mode.name!r} has that module alone" for mode in config.modes.values() if mode.modules == (name,)]
    raise UnknownMode(f"configuration {config.name!r} has no mode {name!r}{''.join(alone) or hint(name, config.modes)}")


def _mode_meant(config: Config, name: str) -> str:
    """A mode by its name, or by the module that exactly one mode consists of."""
    if name in config.modes:
        return name
    alone = [mode.name for mode in config.modes.values() if mode.modules == (name,)]
    if len(alone) == 1:
        return alone[0]
    if alone:
        raise UnknownMode(f"module {name!r} alone makes several modes of {config.name!r}: {', '.join(alone)}; name one")
    raise UnknownMode(f"configuration {config.name!r} has no mode {name!r}{hint(name, config.modes)}")


def _word(word: str, configs: Mapping[str, Config], loaded: str | None) -> tuple[Config, str]:
    """One word in plain text: a mode or module of the loaded configuration, or else a configuration."""
    if loaded is not None:
        try:
            return configs[loaded], _mode_meant(configs[loaded], word)
        except UnknownMode:
            if word not in configs:
                raise
    if word in configs:
        return configs[word], configs[word].first_mode()
    raise NothingLoaded(f"nothing is loaded and {word!r} is not a configuration; there are {listed(configs)}")


def checked_name(name: str) -> str:
    """A file name without folder parts. Raises InvalidRequest."""
    if not name or "/" in name or "\\" in name or name.startswith(".") or "\0" in name or len(name) > 200:
        raise InvalidRequest(f"file name {name!r}: a plain name without folders is expected, such as 'edge.bit'")
    return name


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go.

    `values` overrides registers' defaults: the way back restores what was written. `also` are modules
    beside the mode's, in regions that the mode leaves alone: the way back restores what they held.
    `static` is the full configuration whose image a partial one ran on, for the way back to it.
    `rates` are clocks' rates in Hz that the way back restores, whatever the configuration says of them; `found`
    likewise what registers held, by physical address and width, which no name of the configuration has to reach.
    `reload`: regions that are loaded again, though they hold what is wanted.
    `grounded`: the configuration's own overlays are on, by a plan before this one.
    `unload`: as of `ChangeMode`; `mode` is the one that is left then, or empty.
    """

    config: Config
    mode: str
    force: bool = False
    values: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    also: tuple[str, ...] = ()
    static: Config | None = None
    rates: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    found: Mapping[s.Place, int] = field(default_factory=lambda: MappingProxyType({}))
    grounded: bool = False
    reload: Collection[str] = ()
    unload: str = ""

    @property
    def base(self) -> Config | None:
        """The configuration whose image has to be in the device; None if that cannot be known."""
        return self.config if self.config.type is ConfigType.FULL else self.static


@dataclass(frozen=True, slots=True)
class Plan:
    """Steps from one state to a goal.

    The devices of the static part may come with the configuration's own overlays: the port, clocks, register windows.
    Then `steps` end with those overlays, and `then` is what follows, as far as can be said beforehand: the plan that
    is carried out is made when the devices exist. `ports_later`: the port is among them, and cannot be asked now.
    """

    goal: Goal
    steps: tuple[s.Step, ...]
    full: bool = False
    then: tuple[s.Step, ...] = ()
    ports_later: bool = False

    @property
    def bytes(self) -> int:
        """Bytes that go through configuration ports."""
        return sum([step.length for step in (*self.steps, *self.then)])

    @property
    def regions(self) -> frozenset[str]:
        """The regions that the plan isolates, or that are isolated already."""
        return frozenset(
            step.region.name for step in (*self.steps, *self.then) if isinstance(step, s.Decouple | s.Recouple)
        )

    def info(self, throughput: Throughput) -> PlanInfo:
        """As it is shown."""
        rows = tuple(
            PlanStep(step.kind, step.subject, step.text, step.length, _seconds(step, throughput))
            for step in (*self.steps, *self.then)
        )
        seconds = sum(r.seconds for r in rows)
        clocks = tuple(ClockStatus(c.clock.name, c.clock.rate, c.achieved or 0) for c in self.clocks)
        return PlanInfo(self.goal.config.name, self.goal.mode, rows, self.bytes, seconds, clocks)

    @property
    def clocks(self) -> Iterator[s.SetClock]:
        """The clocks that are set."""
        return (step for step in (*self.steps, *self.then) if isinstance(step, s.SetClock))


def _seconds(step: s.Step, throughput: Throughput) -> float:
    beside = throughput.overhead(step.kind)
    if isinstance(step, s.Load | s.LoadStatic):
        return beside + throughput.seconds(step.port_kind, step.image.length)
    return beside


@dataclass(frozen=True, slots=True)
class OverlayChange:
    """Names to remove, newest first, and overlays to apply, in their order."""

    removed: tuple[str, ...]
    applied: tuple[ApplyOverlay, ...]

    def __bool__(self) -> bool:
        return bool(self.removed or self.applied)


def overlay_change(
    state: BoardState, wanted: Sequence[ApplyOverlay], changed: Collection[str], everything: bool
) -> OverlayChange:
    """From the overlays that are applied to those that are wanted.

    `changed` are the regions that are loaded; with `everything` (a whole image) no overlay stays.
    """
    hashes = {step.overlay.name: step.sha256 for step in wanted}
    loading = {loading_overlay(name): name in changed for name in {*state.regions, *changed}}
    kept = set() if everything else _kept(state.overlays, hashes, loading)
    removed = tuple(o.name for o in reversed(state.overlays) if o.name not in kept)
    return OverlayChange(removed, tuple(w for w in wanted if w.overlay.name not in kept))


def wanted_overlays(config: Config, mode: Mode, files: Files, images: Sequence[Image]) -> list[ApplyOverlay]:
    """Those of a mode, in whose device `images` are. Raises what is wrong with the files."""
    named = {overlay.name: overlay for overlay in (*config.overlays, *mode.overlays)}
    data = [(overlay, files.overlay(config, overlay, images)) for overlay in named.values()]
    return [ApplyOverlay(overlay, blob, sha256(blob)) for overlay, blob in data]


def _kept(applied: Collection[OverlayState], hashes: Mapping[str, str], loading: Mapping[str, bool]) -> set[str]:
    """Names of the overlays that stay.

    Overlays form a stack: to remove one, those applied after it are removed first, as they may depend on its nodes
    and the kernel would refuse. Only those by which other regions were loaded stay: each targets its own region's
    node, and the region's devices would go with it.
    """
    kept: set[str] = set()
    intact = True
    for held in applied:
        stays = not loading[held.name] if held.name in loading else hashes.get(held.name) == held.sha256
        if stays and (intact or held.name in loading):
            kept.add(held.name)
        else:
            intact = False
    return kept


@dataclass(frozen=True, slots=True)
class Writing:
    """The registers of a goal against what was written last.

    `reset` are the regions whose registers have their reset values then: those that are loaded, and
    those that are recoupled (a static part may hold a region in reset while it is cut off).
    """

    goal: Goal
    state: BoardState
    reset: Collection[str]

    def steps(self) -> list[SetRegister]:
        """Writes of registers whose region was reset, or whose value differs from what was written."""
        visible = self.goal.config.visible_registers(self.goal.mode).values()
        writable = [r for r in visible if r.access not in (Access.RO, Access.W1C) and not self._nobody_answers(r)]
        values = [(r, self._value(r)) for r in writable]
        return [
            *(SetRegister(r, value) for r, value in values if value is not None and self._is_due(r, value)),
            *self._starts(),
        ]

    def _starts(self) -> Iterator[SetRegister]:
        """What the mode starts, when all else is set; what runs continuously already goes on."""
        goal = self.goal
        again = goal.config.modes[goal.mode].run == "once" and self.state.mode != goal.mode
        for register, value in goal.config.controls(goal.mode):
            if again or self._is_due(register, value):
                yield SetRegister(replace(register, volatile=True), value)

    def restored(self) -> list[SetRegister]:
        """What a failed change wrote to registers of the static part that this mode has no name for."""
        named = {place_of(r) for r in self.goal.config.visible_registers(self.goal.mode).values()}
        found = {place: value for place, value in self.goal.found.items() if place not in named}
        return [
            SetRegister(Register(f"at {address:#x}", address, 0, width), value, restores=True)
            for (address, width), value in found.items()
        ]

    def _value(self, register: Register) -> int | None:
        value = self.goal.values.get(register.name)
        return self.goal.found.get(place_of(register), register.default) if value is None else value

    def _nobody_answers(self, register: Register) -> bool:
        """A region that this mode leaves alone may hold nothing; only what the mode itself sets is then an error."""
        region, mode = register.region, self.goal.config.modes[self.goal.mode]
        if region is None or region in self.reset or register.name in mode.registers:
            return False
        return self.state.region(region).phase is not RegionPhase.READY

    def _is_due(self, register: Register, value: int) -> bool:
        same_config = self.state.config == self.goal.config.name
        known = self.state.values.get(register.name) if same_config else None
        forced = self.goal.force or place_of(register) in self.goal.found
        return register.region in self.reset or known != value or forced


def place_of(register: Register) -> Place:
    """The place of a register, whatever its name."""
    return register.address, register.width


def clock_steps(goal: Goal, state: BoardState, devices: Devices) -> tuple[SetClock, ...]:
    """The clocks that do not run as the goal wants them, or whose rate is not known.

    Raises ClockRate where a clock cannot come near enough to its rate, DeviceNotFound if the board has clocks, but
    none of that name.
    """
    if not (goal.config.clocks or goal.rates):
        return ()
    clocks = devices.clocks()
    if not clocks.names():  # as it always was there: their rates are not known, which is said once
        unset = (SetClock(clock, 0, None, running=True) for clock in goal.config.clocks.values())
        return tuple(step for step in unset if state.clocks.get(step.clock.name) != 0)
    steps = [_step(clocks.find(name), Clock(name, rate), restores=True) for name, rate in goal.rates.items()]
    named = [clock for clock in goal.config.clocks.values() if clock.name not in goal.rates]
    steps += [_step(clocks.find(clock.name), clock) for clock in named]
    return tuple(step for step in steps if goal.force or _is_due(step, state))


def _step(clock: PlClock, wanted: Clock, restores: bool = False) -> SetClock:
    asked, achieved = nearest_asked(wanted, clock.rounded)
    if achieved is not None and not restores:
        check_rate(wanted, achieved)
    return SetClock(wanted, clock.rate, achieved, clock.enabled, restores, asked)


def nearest_asked(wanted: Clock, rounded: Callable[[int], int | None]) -> tuple[int, int | None]:
    """What to ask of a driver that rounds down, and what comes of it: a rate just above may be nearer.

    A design's own rate is often a few Hz below what the dividers make (142,857,132 for 142,857,141).
    """
    found = {hertz: rounded(hertz) for hertz in (wanted.rate, just_above(wanted))}
    asked = min(found, key=lambda hertz: abs((found[hertz] or hertz) - wanted.rate))
    return asked, found[asked]


def just_above(wanted: Clock) -> int:
    """What may still be meant by a rate: a thousandth more, which no design's timing notices."""
    return wanted.rate + min(int(allowed(wanted)), wanted.rate // 1000)


def _is_due(step: SetClock, state: BoardState) -> bool:
    if state.clocks.get(step.clock.name) != step.before or not step.running:
        return True
    if step.achieved is not None:
        return step.before != step.achieved
    return abs(step.before - step.clock.rate) > allowed(step.clock)


def check_rate(clock: Clock, rate: int) -> None:
    """Raise ClockRate if a rate is further from what is wanted than the schema allows."""
    if problem := rate_problem(clock, rate):
        raise ClockRate(problem)


_WHOLE = (RegionPhase.READY, RegionPhase.DECOUPLED, RegionPhase.LOADED)  # phases in which a known content is certain


def make_plan(
    goal: Goal, state: BoardState, old: Config | None, files: Files, throughput: Throughput, devices: Devices
) -> Plan:
    """The steps to `goal`. Reads and validates every file that it needs; raises what is wrong with them.

    `old` is the configuration the board is in, if it is known. Of the devices only clocks are asked.
    """
    return _Planner(goal, state, old, files, throughput, devices).plan()


class _Planner:
    def __init__(
        self,
        goal: Goal,
        state: BoardState,
        old: Config | None,
        files: Files,
        throughput: Throughput,
        devices: Devices,
    ):
        self._goal = goal
        self._config = goal.config
        self._mode = goal.config.modes[goal.mode] if goal.mode else Mode("")
        self._state = state
        self._old = old
        self._files = files
        self._throughput = throughput
        self._devices = devices
        self._clocks: tuple[s.SetClock, ...] = ()

    def plan(self) -> Plan:
        return self._unloaded() if self._goal.unload else self._entered()

    def _unloaded(self) -> Plan:
        """Isolate regions, and take off the overlays of what ends with them; no bitstream is loaded."""
        names = emptied(self._config, self._goal.unload)
        regions = [self._config.regions[name] for name in names if not self._state.region(name).empty]
        wanted = wanted_overlays(self._config, self._mode, self._files, [])
        overlays = overlay_change(self._state, wanted, names, False)
        if not (regions or overlays or self._elsewhere()):
            return Plan(self._goal, ())
        streams = self._streams(set(names), everything=False)
        stopped = (s.Quiesce(streams),) if streams else ()
        removed = (s.RemoveOverlay(name) for name in overlays.removed)
        cut = (s.Decouple(region) for region in regions)
        publish = s.Publish(self._config.name, self._goal.mode)
        return Plan(self._goal, (s.Validate(()), *stopped, *removed, *cut, *overlays.applied, publish))

    def _entered(self) -> Plan:
        whole = self._whole_images()
        static = whole[0] if whole and not self._goal.grounded and self._is_to_be_loaded(whole[0]) else None
        modules = [self._config.modules[name] for name in (*self._mode.modules, *self._goal.also)]
        images = {m.name: self._files.image(self._config, m) for m in modules}
        changed = [m for m in modules if static or self._differs(m, images[m.name])]
        ready = {name for name, held in self._state.regions.items() if held.phase is RegionPhase.READY}
        cut = [m for m in modules if m not in changed and m.region not in ready]
        loads = [(m, images[m.name]) for m in changed]
        wanted = wanted_overlays(self._config, self._mode, self._files, [*whole, *images.values()])
        overlays = overlay_change(self._state, wanted, {m.region for m in changed}, static is not None)
        ground = self._ground(overlays)
        self._clocks = () if ground and not static else clock_steps(self._goal, self._state, self._devices)
        writing = Writing(self._goal, self._state, {m.region for m in (*changed, *cut)})
        writes = [*([] if static else writing.restored()), *writing.steps()]
        if not (static or changed or cut or overlays or writes or self._clocks or self._elsewhere()):
            return Plan(self._goal, ())
        steps = tuple(self._order(static, loads, cut, overlays, writes))
        known = steps.index(ground[-1]) + 1 if ground else len(steps)
        return Plan(self._goal, steps[:known], static is not None, then=steps[known:])

    def _ground(self, overlays: OverlayChange) -> tuple[s.ApplyOverlay, ...]:
        """The configuration's own overlays, which bring the devices of the static part: they come before all else."""
        own = () if self._goal.grounded else {overlay.name for overlay in self._config.overlays}
        return tuple(step for step in overlays.applied if step.overlay.name in own)

    def _elsewhere(self) -> bool:
        return (self._state.config, self._state.mode) != (self._config.name, self._goal.mode or None)

    def _whole_images(self) -> list[Image]:
        """The image that has to be in the device, if it is known which."""
        base = self._goal.base
        if base is None:
            self._check_static_known()
            return []
        return [self._files.static_image(base)]

    def _is_to_be_loaded(self, image: Image) -> bool:
        here = self._state.static_sha256 == image.sha256 and not self._state.static_lost
        mine = self._goal.base is not self._config or self._state.config == self._config.name
        return not (here and mine) or self._goal.force

    def _check_static_known(self) -> None:
        if self._state.static_lost:
            raise StaticUnknown(
                f"the load of a full image failed, so it is unknown what the device holds; "
                f"{self._config.name} is partial and needs its static part: load a full configuration, "
                "or restart the board"
            )
        if self._state.config is None and not self._devices.holds_design():
            raise StaticUnknown(
                f"nothing says that the PL holds the static part of {self._config.name}: nothing was loaded since the "
                "board was started, and an access of an empty PL stalls the board. Load the image first (fpgautil -b "
                f"{self._config.name}_full.bin -f Full; or type: full with a bitstream, which is loaded then); "
                "cm serve --assume-loaded if the boot loader has loaded it"
            )

    def _differs(self, module: Module, image: Image) -> bool:
        """Whether the region has to be loaded; one that is only cut off holds what it held."""
        held = self._state.region(module.region)
        if (
            self._goal.force
            or module.region in self._goal.reload
            or held.phase not in _WHOLE
            or held.sha256 != image.sha256
        ):
            return True
        by_overlay = self._config.regions[module.region].loader is LoaderKind.OVERLAY
        return by_overlay and loading_overlay(module.region) not in {o.name for o in self._state.overlays}

    def _order(
        self,
        static: Image | None,
        loads: list[tuple[Module, Image]],
        cut: list[Module],
        overlays: OverlayChange,
        writes: list[s.SetRegister],
    ) -> Iterator[s.Step]:
        changed = [m for m, _ in loads]
        joined = [*changed, *cut]
        regions = {m.region for m in joined}
        yield s.Validate((*((static,) if static else ()), *(image for _, image in loads)))
        asked = self._static_check() if loads else ()
        ground = self._ground(overlays)
        if not (static or ground):
            yield from asked
        streams = self._streams(regions, everything=bool(static or ground))
        if streams:
            yield s.Quiesce(streams)
        yield from (s.RemoveOverlay(name) for name in overlays.removed)
        if static:  # it runs from the first moment, so its clocks must be right by then
            yield from self._clocks
            yield self._load_static(static)
        if static or ground:
            yield from ground
            yield from asked
        yield from (s.Decouple(self._region(m)) for m in changed)
        if not static:
            yield from self._clocks
        yield from (self._load(m, image) for m, image in loads)
        yield from (step for step in overlays.applied if step not in ground)
        yield from (w for w in writes if w.register.region not in regions)
        yield from (s.Recouple(self._region(m), self._registers_of(m.region)) for m in joined)
        for m in joined:
            if m.identity is not None and self._region(m).identity is not None:
                yield s.CheckIdentity(self._region(m), m)
        yield from (w for w in writes if w.register.region in regions)
        yield s.Publish(self._config.name, self._goal.mode)

    def _static_check(self) -> tuple[s.CheckStatic, ...]:
        """Check that the modules belong to the present static part; not needed for an image that we loaded."""
        check = s.CheckStatic(self._config.name, self._config.static)
        return (check,) if check.known or self._goal.base is None else ()

    def _region(self, module: Module) -> Region:
        return self._config.regions[module.region]

    def _load(self, module: Module, image: Image) -> s.Load:
        region = self._region(module)
        overlay = b""
        if region.loader is LoaderKind.OVERLAY:
            overlay = self._files.loading_overlay(self._config, module, image)
        return s.Load(region, module, image, self._timeout(region, image), overlay)

    def _load_static(self, image: Image) -> s.LoadStatic:
        base = self._goal.base or self._config
        whole = Region("(device)", loader=base.loader, timeout=base.timeout)
        return s.LoadStatic(image, self._timeout(whole, image), base.name, base.loader)

    def _timeout(self, region: Region, image: Image) -> float:
        """Seconds after which a load counts as hung. Raises StepTimeout for a schema's that is sure to be too short."""
        expected = self._throughput.seconds(region.loader, image.length)
        if region.timeout is not None and region.timeout < expected and region.loader in self._throughput.measured:
            raise StepTimeout(
                f"{self._config.name}: timeout: {region.timeout:g} s of {region.name} is too short for "
                f"{image.path.name}: {image.length} bytes take {expected:.2g} s by {region.loader.value}, "
                "as measured here"
            )
        return self._throughput.timeout(region, image.length)

    def _registers_of(self, region: str) -> frozenset[str]:
        own = self._config.registers_of(region)
        return own if self._old is None or self._old is self._config else own | self._old.registers_of(region)

    def _streams(self, regions: set[str], everything: bool) -> tuple[str, ...]:
        """Present streams that pass through a changed region, or look different afterwards."""
        mode = self._state.mode
        if self._old is None or mode is None or mode not in self._old.modes:
            return ()
        held = self._state.modules
        now = self._old.streams_in(mode, held)
        then = self._config.streams_in(self._mode.name, held) if self._old.name == self._config.name else {}
        return tuple(name for name, x in now.items() if everything or x.region in regions or then.get(name) != x)
