# SPDX-License-Identifier: Apache-2.0
"""A requested change of mode: waited for, cancelled, called back at its end."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from cm.messages.status import ErrorInfo


@dataclass(eq=False)
class Change:
    """A requested change; waited for, cancelled, and called back at its end from the worker's thread."""

    number: int
    config: str
    mode: str
    force: bool = False
    static: str | None = None  # the full configuration to load first, on the way back to a partial one
    scopes: tuple[str, ...] = ()  # what leases of others must not cover
    lease: str = ""  # the requester's own
    error: ErrorInfo | None = None
    seconds: float = 0.0
    on_done: Callable[[Change], None] | None = None
    _cancel: threading.Event = field(default_factory=threading.Event)
    _done: threading.Event = field(default_factory=threading.Event)

    def cancel(self) -> None:
        """Ask it to stop before its next load; it goes back to the mode before."""
        self._cancel.set()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._cancel.is_set()

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self._done.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait for its end; False if it did not come in time."""
        return self._done.wait(timeout)

    def finish(self, error: ErrorInfo | None, seconds: float) -> None:
        """Its end."""
        self.error, self.seconds = error, seconds
        self._done.set()
        if self.on_done is not None:
            self.on_done(self)
