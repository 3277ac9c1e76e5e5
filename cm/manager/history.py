# SPDX-License-Identifier: Apache-2.0
"""What has brought the board to where it is: the last changes with their steps, and the last write of each register.

Kept since the manager's start, within bounds; the record on disk says what is there, not who wanted it.
"""

from __future__ import annotations

from collections import deque
from time import monotonic_ns

from cm.frozen import replace
from cm.wire.messages.status import ErrorInfo, PastChange, PastWrite, StepTaken

CHANGES = 32  # that are kept, beside the last of each region
_STEPS = 400  # of one change


class History:
    """The worker's thread notes changes, that of requests writes; `changes` and `writes` are for any."""

    def __init__(self) -> None:
        self._ended: deque[PastChange] = deque(maxlen=CHANGES)
        self._of_region: dict[str, PastChange] = {}  # the last that has begun to load it, or has unloaded it
        self._running: PastChange | None = None
        self._steps: list[StepTaken] = []
        self.written: dict[str, tuple[int, int, str]] = {}  # value, time and who, by register: a write makes no call

    def begun(self, change: PastChange) -> None:
        """A change runs from now on."""
        self._steps = []
        self._running = replace(change, begun_ns=monotonic_ns())

    def took(self, step: StepTaken) -> None:
        """A step of it was taken, or has failed."""
        if len(self._steps) < _STEPS:
            self._steps.append(step)

    def ended(self, error: ErrorInfo | None) -> None:
        """It has ended."""
        if self._running is None:
            return
        steps = tuple(self._steps)
        change = replace(self._running, ended_ns=monotonic_ns(), error=error, steps=steps)
        self._ended.append(change)
        for step in steps:
            if step.kind in ("load", "repair", "decouple"):
                self._of_region[step.subject] = change
            elif step.kind == "load_full":
                self._of_region.clear()
        if error is None and change.config_name != change.from_config:
            self.written.clear()  # the registers of another configuration are others
        self._running = None

    def changes(self) -> tuple[PastChange, ...]:
        """Those that are remembered, the oldest first."""
        known = {change.number: change for change in (*tuple(self._of_region.values()), *tuple(self._ended))}
        running = self._running
        if running is not None:
            known[running.number] = replace(running, steps=tuple(self._steps))
        return tuple([known[number] for number in sorted(known)])

    def writes(self) -> tuple[PastWrite, ...]:
        """The last one of each register that was written."""
        return tuple([PastWrite(name, value, by, at) for name, (value, at, by) in tuple(self.written.items())])
