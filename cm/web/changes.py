# SPDX-License-Identifier: Apache-2.0
"""The changes of mode so far, with their steps, from the statuses that the manager publishes."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from cm.wire.messages.status import Progress, Status

KEPT = 20
_STEPS_MAX = 200  # of one change that are kept


class ChangeLog:
    """The last changes, newest last, as JSON has them.

    Times are in seconds: `at` since the epoch, others are durations.
    """

    def __init__(self) -> None:
        self.changes: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self._running: dict[str, Any] | None = None
        self._since = 0.0  # when its present step began
        self._last_change: int | None = None

    def take(self, status: Status) -> bool:
        """Note what a status says; returns whether it is new."""
        if status.progress is not None:
            self._goes_on(status.progress)
            return True
        ended = self._last_change is not None and status.last_change > self._last_change
        new = ended or self._running is not None  # one may have been under way when this began to look
        if new:
            self._ended(status)
        self._last_change = status.last_change
        return new

    def forget(self) -> None:
        """Forget all: another manager, or the same one restarted, numbers its changes anew."""
        self._last_change = None
        if self._running is not None:
            self._running.update(state="lost")
            self._running = None

    def _goes_on(self, progress: Progress) -> None:
        now = time.monotonic()
        if self._running is None or self._running["number"] != progress.change:
            self._running = self._new(progress.change, progress.target_config, progress.target_mode)
            self._since = now
        steps = self._running["steps"]
        if not steps or (steps[-1]["step"], steps[-1]["subject"]) != (progress.step, progress.subject):
            self._close_step(now)
            if len(steps) < _STEPS_MAX:
                steps.append({"step": progress.step, "subject": progress.subject, "seconds": None})
            self._since = now
        self._running.update(
            fraction=progress.fraction, bytes_done=progress.bytes_done, bytes_total=progress.bytes_total
        )

    def _new(self, number: int, config: str, mode: str) -> dict[str, Any]:
        change = {"number": number, "config": config, "mode": mode, "at": time.time(), "state": "running", "steps": []}
        self.changes.append(change)
        return change

    def _close_step(self, now: float) -> None:
        assert self._running is not None
        if self._running["steps"]:
            self._running["steps"][-1]["seconds"] = now - self._since

    def _ended(self, status: Status) -> None:
        """A change that began and ended between two statuses has no steps."""
        change = self._running
        if change is None or change["number"] != status.last_change:
            change = self._new(status.last_change, status.config_name, status.mode)
        elif self._running is not None:
            self._close_step(time.monotonic())
        self._running = None
        error = status.last_error
        failed = error is not None and (status.pr_mode.value == "error" or change["mode"] != status.mode)
        change.update(state="failed" if failed else "done", seconds=status.last_change_seconds)
        if failed and error is not None:
            change["error"] = {"code": error.code, "message": error.message}
