# SPDX-License-Identifier: Apache-2.0
"""Regions, and the whole device: cut off, load, connect, ask who answers."""

from __future__ import annotations

from dataclasses import replace

from cm.manager.access.register_bus import drive, is_cut
from cm.manager.errors import IdentityMismatch, WrongStatic
from cm.manager.execution.actions.overlays import note_applied
from cm.manager.execution.context import StepContext
from cm.manager.loaders import Job, Start
from cm.manager.state import steps as s
from cm.manager.state.table import OverlayState, RegionEvent, RegionPhase, all_lost, loading_overlay
from cm.schema.model import LoaderKind


def job_of(run: StepContext, step: s.Load | s.LoadStatic) -> Job:
    """What a loader is given for a step."""
    if isinstance(step, s.LoadStatic):
        return Job(run.plan.goal.config, step.image)
    return Job(run.plan.goal.config, step.image, step.region, step.module, step.overlay)


def decouple(run: StepContext, step: s.Decouple) -> None:
    """Cut off; the state says so first: if it fails, the region may be cut off."""
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
    run.update(lambda state: state.without_values(set(step.resets)))
    run.sealed.discard(step.region.name)
    if step.region.decoupler:
        drive(run.tools.registers, step.region.decoupler, cut=False)
    run.region_event(step.region.name, RegionEvent.RECOUPLE)


def load(run: StepContext, step: s.Load) -> None:
    """Load one region; what it held is forgotten, and that recorded, before the port is touched."""
    run.check_cancelled()
    name = step.region.name
    with run.tools.loaders.kind(step.port_kind).prepared(job_of(run, step), step.timeout) as start:
        _forget_content(run, step)
        run.begun.add(name)
        try:
            _timed(run, step, start)
        except BaseException:
            run.region_event(name, RegionEvent.LOAD_FAILED)
            raise
    held = run.board.region(name).after(RegionEvent.LOAD_DONE)
    run.set_region(name, held.holding(step.module.name, step.image.sha256))
    if step.region.loader is LoaderKind.OVERLAY:
        note_applied(run, OverlayState(loading_overlay(name), step.image.sha256))


def _forget_content(run: StepContext, step: s.Load) -> None:
    name = step.region.name
    before = run.board.region(name)
    run.region_event(name, RegionEvent.LOAD)
    try:
        run.record(step)
    except BaseException:
        run.set_region(name, before)  # nothing was loaded
        raise


def load_static(run: StepContext, step: s.LoadStatic) -> None:
    """Load the whole device; everything that it held is forgotten first."""
    run.check_cancelled()
    with run.tools.loaders.kind(step.port_kind).prepared(job_of(run, step), step.timeout) as start:
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
    started = run.tools.clock.monotonic()
    start(run.tell)
    run.port_seconds = run.tools.clock.monotonic() - started
    run.tools.state.observed(step.port_kind, step.image.length, run.port_seconds)


def check_static(run: StepContext, step: s.CheckStatic) -> None:
    """The static part's identity register has to read what the modules were made with."""
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
    """The region's identity register has to read what the schema says of the module."""
    identity = step.region.identity
    if identity is None or step.module.identity is None:
        return
    value = run.tools.registers.read_address(identity.base_address + identity.offset, identity.width)
    if value != step.module.identity:
        run.region_event(step.region.name, RegionEvent.LOSE)  # it is coupled, but to what?
        raise IdentityMismatch(
            f"region {step.region.name} answers {value:#x} at its identity register; "
            f"module {step.module.name} is {step.module.identity:#x}"
        )
