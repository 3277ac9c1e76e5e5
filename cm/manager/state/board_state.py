# SPDX-License-Identifier: Apache-2.0
"""The state table: what the hardware holds, as frozen data, and which transitions a region may make.

An illegal transition raises and changes nothing. `docs/reconfiguration.md` shows the table as a
diagram that `diagram()` generates.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import Enum
from types import MappingProxyType
from typing import Any

from cm.frozen import dataclass, field, replace


class RegionPhase(str, Enum):
    """Where a region is."""

    UNKNOWN = "unknown"  # nothing is known of its content
    READY = "ready"  # holds a module and is coupled
    DECOUPLED = "decoupled"  # isolated; content as before, or not to be trusted
    LOADING = "loading"  # a bitstream is being loaded into it
    LOADED = "loaded"  # holds the new module, still isolated
    FAILED = "failed"  # a change failed, and so did the way back; stays isolated


class RegionEvent(str, Enum):
    """What happens to a region."""

    DECOUPLE = "decouple"
    LOAD = "load"
    LOAD_DONE = "load_done"
    LOAD_FAILED = "load_failed"
    RECOUPLE = "recouple"
    ISOLATE = "isolate"
    LOSE = "lose"


_P, _E = RegionPhase, RegionEvent

TRANSITIONS: Mapping[tuple[RegionPhase, RegionEvent], RegionPhase] = MappingProxyType(
    {
        (_P.UNKNOWN, _E.DECOUPLE): _P.DECOUPLED,
        (_P.READY, _E.DECOUPLE): _P.DECOUPLED,
        (_P.FAILED, _E.DECOUPLE): _P.DECOUPLED,
        (_P.DECOUPLED, _E.DECOUPLE): _P.DECOUPLED,
        (_P.LOADED, _E.DECOUPLE): _P.DECOUPLED,
        (_P.DECOUPLED, _E.LOAD): _P.LOADING,
        (_P.LOADING, _E.LOAD_DONE): _P.LOADED,
        (_P.LOADING, _E.LOAD_FAILED): _P.DECOUPLED,
        (_P.LOADED, _E.RECOUPLE): _P.READY,
        (_P.DECOUPLED, _E.RECOUPLE): _P.READY,
        (_P.DECOUPLED, _E.ISOLATE): _P.FAILED,
        (_P.LOADED, _E.ISOLATE): _P.FAILED,
        (_P.LOADING, _E.ISOLATE): _P.FAILED,
        (_P.FAILED, _E.ISOLATE): _P.FAILED,
        (_P.UNKNOWN, _E.ISOLATE): _P.FAILED,
        (_P.UNKNOWN, _E.LOSE): _P.UNKNOWN,
        (_P.READY, _E.LOSE): _P.UNKNOWN,
        (_P.DECOUPLED, _E.LOSE): _P.UNKNOWN,
        (_P.LOADING, _E.LOSE): _P.UNKNOWN,
        (_P.LOADED, _E.LOSE): _P.UNKNOWN,
        (_P.FAILED, _E.LOSE): _P.UNKNOWN,
    }
)


class IllegalTransition(RuntimeError):
    """An event that is not in the table: a defect of the manager, never of a request."""


@dataclass(frozen=True, slots=True)
class RegionState:
    """A region's phase and what it holds; `module` and `sha256` are None when that is not known."""

    phase: RegionPhase = RegionPhase.UNKNOWN
    module: str | None = None
    sha256: str | None = None

    def after(self, event: RegionEvent) -> RegionState:
        """The state after an event.

        LOAD, LOAD_FAILED and LOSE forget the content, and so does what follows a failure: a region that
        was left cut off is loaded again. DECOUPLE and RECOUPLE do not touch it.
        """
        phase = TRANSITIONS.get((self.phase, event))
        if phase is None:
            raise IllegalTransition(f"region in phase {self.phase.value} cannot {event.value}")
        recovers = self.phase is RegionPhase.FAILED and phase is not RegionPhase.FAILED
        if recovers or event in (RegionEvent.LOAD, RegionEvent.LOAD_FAILED, RegionEvent.LOSE):
            return RegionState(phase)
        return replace(self, phase=phase)

    @property
    def empty(self) -> bool:
        """Whether it is isolated, and nothing that it may hold counts: it was unloaded."""
        return self.phase is RegionPhase.DECOUPLED and self.sha256 is None

    def holding(self, module: str, sha256: str) -> RegionState:
        """The same phase with content."""
        return replace(self, module=module, sha256=sha256)


@dataclass(frozen=True, slots=True)
class OverlayState:
    """An applied overlay: its name in configfs and the hash of its file."""

    name: str
    sha256: str


def loading_overlay(region: str) -> str:
    """Name in configfs of the overlay by which a region's module was loaded."""
    return f"cm-{region}"


_UNKNOWN = RegionState()


def _empty() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class BoardState:
    """What the hardware holds, as far as the manager knows."""

    config: str | None = None
    mode: str | None = None
    schema: str = ""  # the sha256 of the text by which that configuration was loaded
    static_sha256: str | None = None  # of a full image that this manager loaded; None: what was there at boot
    static_config: str | None = None  # the configuration of that image
    static_lost: bool = False  # a load of a full image began and did not end well
    regions: Mapping[str, RegionState] = field(default_factory=_empty)
    overlays: tuple[OverlayState, ...] = ()  # in the order they were applied
    values: Mapping[str, int] = field(default_factory=_empty)  # registers written since their region was loaded
    clocks: Mapping[str, int] = field(
        default_factory=_empty
    )  # Hz as read back after they were set; 0: nothing here sets them

    def region(self, name: str) -> RegionState:
        """State of a region; one never heard of is unknown."""
        return self.regions.get(name, _UNKNOWN)

    @property
    def modules(self) -> Mapping[str, str | None]:
        """The module that each region holds, as far as is known."""
        return {name: region.module for name, region in self.regions.items()}

    def with_region(self, name: str, region: RegionState) -> BoardState:
        """A copy with one region changed."""
        return replace(self, regions=MappingProxyType({**self.regions, name: region}))

    def with_clock(self, name: str, rate: int) -> BoardState:
        """A copy that remembers a clock's rate."""
        return replace(self, clocks=MappingProxyType({**self.clocks, name: rate}))

    def values_since(self, before: BoardState, but: Collection[str]) -> Mapping[str, int]:
        """Of registers that were written since then, all `but` some; the names are of the same configuration."""
        if self.config != before.config:
            return _empty()
        return {n: v for n, v in self.values.items() if n not in but and before.values.get(n) != v}

    def without_values(self, registers: Collection[str]) -> BoardState:
        """A copy that has forgotten values which a load has reset."""
        kept = {name: value for name, value in self.values.items() if name not in registers}
        return replace(self, values=MappingProxyType(kept))


def slept(state: BoardState) -> BoardState:
    """After a sleep, in which the PL may have lost its power; what the boot loader put there is taken to be there."""
    lost = all_lost(state)
    if state.static_sha256 is not None or state.static_lost:
        return lost
    return replace(state, regions=lost.regions, values=_empty())


def taken(state: BoardState) -> BoardState:
    """After a load by another program: nothing is known of what the PL holds, as on a board that others have loaded."""
    return replace(all_lost(state), static_lost=state.static_lost)


def without_overlays(state: BoardState, gone: Collection[str]) -> BoardState:
    """After others have removed overlays: the devices that a mode needs are not there, nor what an overlay loaded."""
    regions = {
        name: region.after(RegionEvent.LOSE) if loading_overlay(name) in gone else region
        for name, region in state.regions.items()
    }
    kept = tuple(overlay for overlay in state.overlays if overlay.name not in gone)
    return replace(state, mode=None, regions=MappingProxyType(regions), overlays=kept)


def all_lost(state: BoardState) -> BoardState:
    """While a full image is loaded nothing is known of the device but what the kernel keeps: overlays and clocks."""
    lost = {name: region.after(RegionEvent.LOSE) for name, region in state.regions.items()}
    return BoardState(regions=MappingProxyType(lost), overlays=state.overlays, static_lost=True, clocks=state.clocks)


def diagram() -> str:
    """The table as a Mermaid state diagram, for the documentation."""
    lines = ["stateDiagram-v2", "    [*] --> unknown"]
    lines += [f"    {a.value} --> {b.value}: {event.value}" for (a, event), b in TRANSITIONS.items() if a is not b]
    return "\n".join(lines) + "\n"
