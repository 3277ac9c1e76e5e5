# SPDX-License-Identifier: Apache-2.0
"""What is known: the configurations, and what the board holds, kept in memory and in the record.

All values are immutable, and are swapped. `lock` keeps register accesses of requests and the
moments at which a change takes regions away from overlapping; both threads take it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from cm.manager.errors import RecordFailed, StoreCorrupt
from cm.manager.state.record import Journal, Pending, Record, Throughput, WayBack
from cm.manager.state.steps import ApplyOverlay, Choice, Place, RemoveOverlay, SetClock, Step
from cm.manager.state.table import BoardState
from cm.manager.state.totals import ChangeTotals
from cm.schema.model import Config, LoaderKind, Memory
from cm.wire.messages.status import ErrorInfo


@dataclass(frozen=True, slots=True)
class LockedRegions:
    """What a running change has locked against requests: regions, or the whole device."""

    regions: frozenset[str] = frozenset()
    whole: bool = False

    def __contains__(self, region: object) -> bool:
        return self.whole or region in self.regions


class ManagerState:
    """What the manager knows, and its record on disk."""

    def __init__(self, configs: Mapping[str, Config], journal: Journal) -> None:
        self.configs: Mapping[str, Config] = MappingProxyType(dict(configs))  # all that can be loaded
        self.latest = BoardState()  # what the board holds, except for `_written`
        self.throughput = Throughput()
        self.totals = ChangeTotals()  # since this manager's start
        self.choices: Mapping[tuple[str, str], Choice] = MappingProxyType({})  # by configuration and region
        self.lock = threading.RLock()
        self.pending: Pending | None = None  # the change under way
        self.way_back: WayBack | None = None  # of the last change, where its requester wanted it kept
        self.locked = LockedRegions()
        self.runtime_memories: Mapping[str, Memory] = MappingProxyType(
            {}
        )  # defined at run time, for this configuration
        self._journal = journal
        self._boot_id = ""
        self._number = 0
        self.generation = 0  # of the registers
        self._recorded: Pending | None = None  # as it stands in the record
        self._dirty = False
        self.urgent = False  # something was noted that is nowhere but here
        self._written: dict[str, int] = {}  # registers that were written since `latest` was made

    @property
    def board(self) -> BoardState:
        """What the board holds, as far as is known; replaced by `update`."""
        if self._written:
            with self.lock:
                values = MappingProxyType({**self.latest.values, **self._written})
                self.latest, self._written = replace(self.latest, values=values), {}
        return self.latest

    def note_written(self, register: str, value: int, only_here: bool = False) -> None:
        """Remember a register's written value; its cost does not grow with what is remembered.

        `only_here`: nobody can read it back from the hardware, so it has to be on disk before its write is confirmed.
        """
        with self.lock:
            self._written[register] = value
            self._dirty = True
            if only_here:
                self.urgent = True

    def written(self) -> int:
        """All noted values are in the registers; returns the number of this generation of them."""
        with self.lock:
            self.generation += 1
            return self.generation

    def note_found(self, place: Place, value: int) -> None:
        """Remember what a register held before the change that runs, for the way back after a crash."""
        with self.lock:
            if self.pending is not None:
                self.pending = replace(self.pending, found=(*self.pending.found, (*place, value)))

    def written_value(self, register: str) -> int | None:
        """What was last written to a register since its region was loaded."""
        with self.lock:
            value = self._written.get(register)
            return self.latest.values.get(register) if value is None else value

    def loaded_config(self) -> Config | None:
        """The configuration that is loaded."""
        name = self.latest.config
        return self.configs.get(name) if name else None

    def add_config(self, config: Config) -> None:
        """Make a configuration known, in place of one of its name."""
        self.configs = MappingProxyType({**self.configs, config.name: config})
        if config.name == self.latest.config:
            self.runtime_memories = MappingProxyType({})

    def forget_config(self, name: str) -> None:
        """Make a configuration unknown."""
        self.configs = MappingProxyType({known: config for known, config in self.configs.items() if known != name})

    def choose(self, config: str, choices: Mapping[str, Choice]) -> None:
        """Keep which ports load the regions of a configuration whose schema leaves that open."""
        if choices:
            self.choices = MappingProxyType({**self.choices, **{(config, name): c for name, c in choices.items()}})

    def next_number(self) -> int:
        """The number of a new change."""
        self._number += 1
        return self._number

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state in one piece; both threads do."""
        with self.lock:
            before = self.board
            self.latest = change(before)
            if self.latest.config != before.config:
                self.runtime_memories = MappingProxyType({})

    def lock_regions(self, regions: frozenset[str], whole: bool = False) -> None:
        """Lock these regions' registers, or all, against requests; waits for an access under way."""
        with self.lock:
            self.locked = LockedRegions(regions, whole)

    def release_regions(self) -> None:
        """Requests may access what they could before."""
        self.lock_regions(frozenset())

    def define(self, memory: Memory) -> None:
        """Make a memory known until the configuration changes, in place of one of its name."""
        with self.lock:
            self.runtime_memories = MappingProxyType({**self.runtime_memories, memory.name: memory})

    def observed(self, kind: LoaderKind, length: int, seconds: float) -> None:
        """Keep a measurement for plans and time-outs."""
        self.throughput = self.throughput.observed(kind, length, seconds)
        self.totals.loaded(kind.value, length, seconds)

    def took(self, step: str, seconds: float, port_seconds: float) -> None:
        """Keep how long a kind of step took, without the time of the port, for plans."""
        self.throughput = self.throughput.took(step, seconds - port_seconds)
        self.totals.took(step, seconds)

    # ---- the record ----------------------------------------------------------------

    def read_record(self) -> tuple[Record | None, str]:
        """The record, and a sentence where it was not readable: then nothing is known, which is no reason to stop."""
        try:
            return self._journal.read(), ""
        except StoreCorrupt as error:
            return None, str(error)

    def adopt(self, record: Record | None, board: BoardState, boot_id: str) -> None:
        """Begin with what was found at start: what the board holds, and what the record says beside it."""
        self.latest, self._written, self._boot_id = board, {}, boot_id
        self.way_back = record.way_back if record is not None and record.boot_id == boot_id else None
        self.runtime_memories = MappingProxyType({})
        if record is not None:
            self.throughput, self._number = record.throughput, record.number

    def record(self, step: Step | None) -> None:
        """Write the state and the step about to be taken, or that no change is under way. Raises RecordFailed."""
        with self.lock:
            if self.pending is not None and step is not None:
                self.pending = _about_to(self.pending, step)
            self._write(None if step is None else self.pending)

    def _write(self, pending: Pending | None) -> None:
        try:
            known = Record(self._boot_id, self.board, pending, self.throughput, self._number, self.way_back)
            self._journal.write(known)
        except OSError as error:
            raise RecordFailed(f"the state record could not be written: {error}") from error
        self._recorded, self._dirty, self.urgent = pending, False, False

    def try_record(self) -> ErrorInfo | None:
        """Write that no change is under way; what went wrong, if it could not be written."""
        return self._tried(None)

    def flush(self) -> ErrorInfo | None:
        """Write values of registers that requests wrote; a change that runs meanwhile stays under way."""
        return self._tried(self._recorded) if self._dirty else None

    def _tried(self, pending: Pending | None) -> ErrorInfo | None:
        try:
            with self.lock:
                self._write(pending)
        except RecordFailed as problem:
            return ErrorInfo(problem.code, str(problem))
        return None


def _about_to(pending: Pending, step: Step) -> Pending:
    rates = pending.rates
    if isinstance(step, SetClock) and step.before:
        rates = {step.clock.name: step.before, **rates}
    return replace(pending, step=step.kind, subject=step.subject, overlay=_overlay_name(step), rates=rates)


def _overlay_name(step: Step) -> str | None:
    if isinstance(step, ApplyOverlay):
        return step.overlay.name
    return step.name if isinstance(step, RemoveOverlay) else None
