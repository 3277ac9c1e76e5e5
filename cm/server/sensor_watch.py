# SPDX-License-Identifier: Apache-2.0
"""Reads the board's sensors every few seconds, in a thread of its own, so that a hanging bus delays nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable

from cm.device.paths import Root
from cm.device.sensors import read_sensors
from cm.wire.messages.status import SensorStatus

_SECONDS = 2.0  # between two readings
_SECONDS_WITHOUT = 30.0  # the same if there are none: an overlay may bring some


class SensorWatch:
    """Passes what it reads to `tell`, in its own thread."""

    def __init__(self, root: Root, tell: Callable[[tuple[SensorStatus, ...]], None]) -> None:
        self._root = root
        self._tell = tell
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="cm-sensors", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End; a reading that hangs is abandoned."""
        self._ended.set()

    def _watch(self) -> None:
        while True:
            found = read_sensors(self._root)
            self._tell(tuple([SensorStatus(r.device, r.name, r.quantity, r.value) for r in found]))
            if self._ended.wait(_SECONDS if found else _SECONDS_WITHOUT):
                return
