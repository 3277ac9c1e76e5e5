# SPDX-License-Identifier: Apache-2.0
"""From what the board holds and where it shall go to the steps in between; touches nothing.

The order is that of the design: validate, quiesce, decouple, load, overlays, registers, verify,
recouple, publish — with two deviations that the hardware asks for. Overlays that go are removed
before their region is cut off (their drivers talk to it). A module's own registers and its identity
lie behind the decoupler (PG375), so they are written and checked after recoupling, while the streams
are still stopped.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from cm.manager import steps as s
from cm.manager.cost import Throughput
from cm.manager.errors import StaticUnknown
from cm.manager.loaders import loading_overlay
from cm.manager.ports import Files, Image
from cm.manager.state import BoardState, RegionPhase
from cm.messages.status import PlanInfo, PlanStep
from cm.schema.model import Access, Config, ConfigType, LoaderKind, Module, Overlay, Region, Register


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go.

    `values` overrides registers' defaults: the way back restores what was written. `static` is the full
    configuration whose image a partial one was running in, for the way back to it.
    """

    config: Config
    mode: str
    force: bool = False
    values: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    static: Config | None = None

    @property
    def base(self) -> Config | None:
        """The configuration whose image has to be in the device; None where that cannot be known."""
        return self.config if self.config.type is ConfigType.FULL else self.static


@dataclass(frozen=True, slots=True)
class Plan:
    """Steps from one state to a goal."""

    goal: Goal
    steps: tuple[s.Step, ...]
    full: bool = False

    @property
    def bytes(self) -> int:
        """Bytes that go through configuration ports."""
        return sum(map(image_bytes, self.steps))

    def info(self, throughput: Throughput) -> PlanInfo:
        """As it is shown."""
        rows = tuple(
            PlanStep(step.kind, step.subject, step.text, image_bytes(step), _seconds(step, throughput))
            for step in self.steps
        )
        return PlanInfo(self.goal.config.name, self.goal.mode, rows, self.bytes, sum(r.seconds for r in rows))


def make_plan(goal: Goal, state: BoardState, old: Config | None, files: Files, throughput: Throughput) -> Plan:
    """The steps to `goal`. Reads and validates every file that it needs; raises what is wrong with them.

    `old` is the configuration the board is in, if it is known.
    """
    return _Planner(goal, state, old, files, throughput).plan()


class _Planner:
    def __init__(self, goal: Goal, state: BoardState, old: Config | None, files: Files, throughput: Throughput):
        self._goal = goal
        self._config = goal.config
        self._mode = goal.config.modes[goal.mode]
        self._state = state
        self._old = old
        self._files = files
        self._throughput = throughput

    def plan(self) -> Plan:
        static = self._static_image()
        modules = [self._config.modules[name] for name in self._mode.modules]
        images = {m.name: self._files.image(self._config, m) for m in modules}
        changed = [m for m in modules if static or self._differs(m, images[m.name])]
        removed, applied = self._overlays({m.region for m in changed}, everything=static is not None)
        writes = self._writes({m.region for m in changed})
        if not (static or changed or removed or applied or writes or self._elsewhere()):
            return Plan(self._goal, ())
        steps = self._order(static, changed, images, removed, applied, writes)
        return Plan(self._goal, tuple(steps), full=static is not None)

    def _elsewhere(self) -> bool:
        return (self._state.config, self._state.mode) != (self._config.name, self._goal.mode)

    def _static_image(self) -> Image | None:
        base = self._goal.base
        if base is None:
            self._check_static_known()
            return None
        image = self._files.static_image(base)
        here = self._state.static_sha256 == image.sha256 and not self._state.static_lost
        mine = base is not self._config or self._state.config == self._config.name
        return None if here and mine and not self._goal.force else image

    def _check_static_known(self) -> None:
        if self._state.static_lost:
            raise StaticUnknown(
                f"the load of a full image did not end well, so nobody knows what the device holds; "
                f"{self._config.name} is partial and needs its static part: load a full configuration, "
                "or restart the board"
            )

    def _differs(self, module: Module, image: Image) -> bool:
        held = self._state.region(module.region)
        if self._goal.force or held.phase is not RegionPhase.READY or held.sha256 != image.sha256:
            return True
        by_overlay = self._config.regions[module.region].loader is LoaderKind.OVERLAY
        return by_overlay and loading_overlay(module.region) not in {o.name for o in self._state.overlays}

    def _overlays(self, changed: set[str], everything: bool) -> tuple[list[str], list[s.ApplyOverlay]]:
        """Names to remove (newest first) and overlays to apply.

        Overlays form a stack: one that goes takes those applied after it off with it, or the kernel
        refuses (they may hang from its nodes). Only those by which other regions were loaded stay:
        each targets its own region's node, and off with it would go the region's devices.
        """
        wanted = [self._apply_step(o) for o in _unique((*self._config.overlays, *self._mode.overlays))]
        hashes = {step.overlay.name: step.sha256 for step in wanted}
        loading = {loading_overlay(name): name in changed for name in {*self._state.regions, *changed}}
        kept: set[str] = set()
        intact = not everything
        for held in self._state.overlays:
            stays = not loading[held.name] if held.name in loading else hashes.get(held.name) == held.sha256
            if not everything and stays and (intact or held.name in loading):
                kept.add(held.name)
            else:
                intact = False
        removed = [o.name for o in reversed(self._state.overlays) if o.name not in kept]
        return removed, [w for w in wanted if w.overlay.name not in kept]

    def _apply_step(self, overlay: Overlay) -> s.ApplyOverlay:
        data = self._files.overlay(self._config, overlay)
        return s.ApplyOverlay(overlay, data, hashlib.sha256(data).hexdigest())

    def _writes(self, loaded: set[str]) -> list[s.SetRegister]:
        """Registers to write: where their region was loaded, or where the value differs from what was written."""
        found = []
        for register in self._config.visible_registers(self._goal.mode).values():
            value = self._goal.values.get(register.name, register.default)
            if value is None or register.access in (Access.RO, Access.W1C) or self._nobody_answers(register, loaded):
                continue
            known = None if self._elsewhere_config() else self._state.values.get(register.name)
            if register.region in loaded or known != value or self._goal.force:
                found.append(s.SetRegister(register, value))
        return found

    def _nobody_answers(self, register: Register, loaded: set[str]) -> bool:
        """A region that this mode leaves alone may hold nothing; only what the mode itself sets is then an error."""
        region = register.region
        if region is None or region in loaded or register.name in self._mode.registers:
            return False
        return self._state.region(region).phase is not RegionPhase.READY

    def _elsewhere_config(self) -> bool:
        return self._state.config != self._config.name

    def _order(
        self,
        static: Image | None,
        changed: list[Module],
        images: Mapping[str, Image],
        removed: list[str],
        applied: list[s.ApplyOverlay],
        writes: list[s.SetRegister],
    ) -> Iterable[s.Step]:
        regions = {m.region for m in changed}
        behind = [w for w in writes if w.register.region in regions]
        front = [w for w in writes if w.register.region not in regions]
        yield s.Validate((*((static,) if static else ()), *(images[m.name] for m in changed)))
        streams = self._streams(regions, everything=static is not None)
        if streams:
            yield s.Quiesce(streams)
        yield from (s.RemoveOverlay(name) for name in removed)
        if static:
            yield self._load_static(static)
        yield from (s.Decouple(self._config.regions[m.region]) for m in changed)
        yield from (self._load(m, images[m.name]) for m in changed)
        yield from applied
        yield from front
        yield from (s.Recouple(self._config.regions[m.region]) for m in changed)
        yield from (s.CheckIdentity(self._config.regions[m.region], m) for m in changed if self._has_identity(m))
        yield from behind
        yield s.Publish(self._config.name, self._goal.mode)

    def _has_identity(self, module: Module) -> bool:
        return module.identity is not None and self._config.regions[module.region].identity is not None

    def _load(self, module: Module, image: Image) -> s.Load:
        region = self._config.regions[module.region]
        resets = frozenset(name for name, r in self._all_registers() if r.region == region.name)
        overlay = b""
        if region.loader is LoaderKind.OVERLAY:
            overlay = self._files.loading_overlay(self._config, module, image)
        return s.Load(region, module, image, self._throughput.timeout(region, image.length), resets, overlay)

    def _load_static(self, image: Image) -> s.LoadStatic:
        base = self._goal.base or self._config
        whole = Region("(device)", loader=base.loader, timeout=base.timeout)
        return s.LoadStatic(image, self._throughput.timeout(whole, image.length), base.name, base.loader)

    def _all_registers(self) -> Iterable[tuple[str, Register]]:
        for config in (self._config, *((self._old,) if self._old else ())):
            for mode in config.modes:
                yield from config.visible_registers(mode).items()

    def _streams(self, regions: set[str], everything: bool) -> tuple[str, ...]:
        """Streams of today that pass through a changed region, or look different afterwards."""
        mode = self._state.mode
        if self._old is None or mode is None or mode not in self._old.modes:
            return ()
        now = self._old.modes[mode].streams
        then = self._mode.streams if self._old.name == self._config.name else {}
        return tuple(name for name, x in now.items() if everything or x.region in regions or then.get(name) != x)


def _unique(overlays: Iterable[Overlay]) -> list[Overlay]:
    return list({overlay.name: overlay for overlay in overlays}.values())


def image_bytes(step: s.Step) -> int:
    """Bytes that a step sends through a configuration port."""
    return step.image.length if isinstance(step, s.Load | s.LoadStatic) else 0


def _seconds(step: s.Step, throughput: Throughput) -> float:
    if isinstance(step, s.Load | s.LoadStatic):
        return throughput.seconds(step.port_kind, step.image.length)
    return 0.0
