# SPDX-License-Identifier: Apache-2.0
"""Which overlays a change takes off and puts on."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from cm.manager.ports import Files, Image
from cm.manager.state.steps import ApplyOverlay
from cm.manager.state.table import BoardState, OverlayState, loading_overlay
from cm.schema.model import Config, Mode


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
    return [ApplyOverlay(overlay, blob, hashlib.sha256(blob).hexdigest()) for overlay, blob in data]


def _kept(applied: Collection[OverlayState], hashes: Mapping[str, str], loading: Mapping[str, bool]) -> set[str]:
    """Names of the overlays that stay.

    Overlays form a stack: one that goes takes those applied after it off with it, or the kernel
    refuses (they may hang from its nodes). Only those by which other regions were loaded stay: each
    targets its own region's node, and off with it would go the region's devices.
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
