# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays: off and on. Devices may come and go with them, so register windows are opened anew."""

from __future__ import annotations

from dataclasses import replace

from cm.manager.execution.transaction import StepContext
from cm.manager.state import steps as s
from cm.manager.state.table import BoardState, OverlayState


def remove(run: StepContext, step: s.RemoveOverlay) -> None:
    """Take an overlay off, if it is still there."""
    overlays = run.tools.devices.overlays()
    if step.name in overlays.list():
        overlays.remove(step.name)
    run.update(lambda state: _without(state, step.name))
    run.tools.registers.forget()


def apply(run: StepContext, step: s.ApplyOverlay) -> None:
    """Put an overlay on, in place of a leftover one with its name."""
    overlays = run.tools.devices.overlays()
    if step.overlay.name in overlays.list():
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
