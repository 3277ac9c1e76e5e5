# SPDX-License-Identifier: Apache-2.0
"""From what the board holds and a goal to the steps between them; touches nothing.

The order is that of the design: validate, quiesce, decouple, load, overlays, registers, verify, recouple, publish —
with three deviations that the hardware requires. Overlays that go are removed before their region is cut off (their
drivers talk to it). A configuration's own overlays come first of all: they bring the devices that the other steps need,
and the plan ends there until these exist. A module's own registers and its identity lie behind the decoupler (PG375),
so they are written and checked after recoupling, while the streams are still stopped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cm.manager.errors import StaticUnknown
from cm.manager.interfaces import Devices, Files, Image
from cm.manager.planning.goals import Goal, Plan
from cm.manager.planning.settings import OverlayChange, Writing, clock_steps, overlay_change, wanted_overlays
from cm.manager.state import steps as s
from cm.manager.state.record import Throughput
from cm.manager.state.table import BoardState, RegionPhase, loading_overlay
from cm.schema.model import Config, LoaderKind, Module, Region

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
        self._mode = goal.config.modes[goal.mode]
        self._state = state
        self._old = old
        self._files = files
        self._throughput = throughput
        self._devices = devices
        self._clocks: tuple[s.SetClock, ...] = ()

    def plan(self) -> Plan:
        whole = self._whole_images()
        static = whole[0] if whole and not self._goal.grounded and self._is_to_be_loaded(whole[0]) else None
        modules = [self._config.modules[name] for name in (*self._mode.modules, *self._goal.also)]
        images = {m.name: self._files.image(self._config, m) for m in modules}
        changed = [m for m in modules if static or self._differs(m, images[m.name])]
        cut = [m for m in modules if m not in changed and not self._is_ready(m)]
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
        return (self._state.config, self._state.mode) != (self._config.name, self._goal.mode)

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

    def _is_ready(self, module: Module) -> bool:
        return self._state.region(module.region).phase is RegionPhase.READY

    def _differs(self, module: Module, image: Image) -> bool:
        """Whether the region has to be loaded; one that is only cut off holds what it held."""
        held = self._state.region(module.region)
        if self._goal.force or held.phase not in _WHOLE or held.sha256 != image.sha256:
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
        yield from (self._recouple(self._region(m)) for m in joined)
        yield from (s.CheckIdentity(self._region(m), m) for m in joined if self._has_identity(m))
        yield from (w for w in writes if w.register.region in regions)
        yield s.Publish(self._config.name, self._goal.mode)

    def _static_check(self) -> tuple[s.CheckStatic, ...]:
        """Check that the modules belong to the present static part; not needed for an image that we loaded."""
        check = s.CheckStatic(self._config.name, self._config.static)
        return (check,) if check.known or self._goal.base is None else ()

    def _region(self, module: Module) -> Region:
        return self._config.regions[module.region]

    def _has_identity(self, module: Module) -> bool:
        return module.identity is not None and self._region(module).identity is not None

    def _load(self, module: Module, image: Image) -> s.Load:
        region = self._region(module)
        overlay = b""
        if region.loader is LoaderKind.OVERLAY:
            overlay = self._files.loading_overlay(self._config, module, image)
        return s.Load(region, module, image, self._throughput.timeout(region, image.length), overlay)

    def _load_static(self, image: Image) -> s.LoadStatic:
        base = self._goal.base or self._config
        whole = Region("(device)", loader=base.loader, timeout=base.timeout)
        return s.LoadStatic(image, self._throughput.timeout(whole, image.length), base.name, base.loader)

    def _recouple(self, region: Region) -> s.Recouple:
        return s.Recouple(region, frozenset(self._registers_of(region.name)))

    def _registers_of(self, region: str) -> Iterable[str]:
        for config in (self._config, *((self._old,) if self._old else ())):
            for mode in config.modes:
                yield from (name for name, r in config.visible_registers(mode).items() if r.region == region)

    def _streams(self, regions: set[str], everything: bool) -> tuple[str, ...]:
        """Present streams that pass through a changed region, or look different afterwards."""
        mode = self._state.mode
        if self._old is None or mode is None or mode not in self._old.modes:
            return ()
        held = self._state.modules
        now = self._old.streams_in(mode, held)
        then = self._config.streams_in(self._mode.name, held) if self._old.name == self._config.name else {}
        return tuple(name for name, x in now.items() if everything or x.region in regions or then.get(name) != x)
