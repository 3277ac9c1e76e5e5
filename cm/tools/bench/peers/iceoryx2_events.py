# SPDX-License-Identifier: Apache-2.0
"""iceoryx2's Python events: notify there, notify back; the samples' memory is not touched, so size does not matter."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import iceoryx2


class _Ends:
    """A notifier one way and a listener the other."""

    def __init__(self, folder: Path, there: str, back: str) -> None:
        iceoryx2.set_log_level(iceoryx2.LogLevel.Error)
        self._node: Any = iceoryx2.NodeBuilder.new().create(iceoryx2.ServiceType.Ipc)
        self._out = self._service(f"{folder}/{there}")
        self._in = self._service(f"{folder}/{back}")
        self._notifier: Any = self._out.notifier_builder().create()
        self._listener: Any = self._in.listener_builder().create()

    def _service(self, name: str) -> Any:
        return self._node.service_builder(iceoryx2.ServiceName.new(name)).event().open_or_create()

    def notify(self) -> None:
        self._notifier.notify()

    def wait(self) -> None:
        while not self._came():
            continue

    def _came(self) -> bool:
        try:
            return bool(self._listener.blocking_wait())
        except iceoryx2.ListenerWaitError as error:
            if "InterruptSignal" not in str(error):
                raise
            return False  # interrupted by a signal, or the process was stopped for a while


class EventsNear(_Ends):
    """This end of the events."""

    def trip(self) -> None:
        """There and back."""
        self.notify()
        self.wait()

    def close(self) -> None:
        """The node's end closes its services."""


def near(folder: Path, size: int) -> EventsNear:  # noqa: ARG001 (of no consequence)
    """This end."""
    return EventsNear(folder, "there", "back")


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (of no consequence)
    """The other end."""
    ends = _Ends(folder, "back", "there")
    ready()
    while True:
        ends.wait()
        ends.notify()
