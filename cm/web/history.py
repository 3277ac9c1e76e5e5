# SPDX-License-Identifier: Apache-2.0
"""What is drawn over time: a point per second, for the last ten minutes."""

from __future__ import annotations

from collections import deque
from typing import Any

from cm.wire.messages.status import Status

KEPT = 600
_SERIES_MAX = 64


class History:
    """Series by name, as JSON has them: ``rate:camera``, ``latency:camera``, ``temperature:xadc temp0``, ``change``."""

    def __init__(self) -> None:
        self._points: deque[tuple[float, dict[str, float]]] = deque(maxlen=KEPT)
        self._last_change: int | None = None

    def add(self, now: float, status: Status) -> dict[str, Any]:
        """One more point, at `now` (seconds since the epoch); returned as JSON has it."""
        values: dict[str, float] = {}
        for stream in status.streams:
            if stream.open:
                values[f"rate:{stream.name}"] = round(stream.rate, 2)
                values[f"latency:{stream.name}"] = round(stream.latency_us, 1)
        for sensor in status.sensors:
            values[f"{sensor.quantity}:{sensor.device} {sensor.name}"] = round(sensor.value, 4)
        if self._last_change not in (None, status.last_change):
            values["change"] = round(status.last_change_seconds * 1000, 3)
        self._last_change = status.last_change
        values = dict(list(values.items())[:_SERIES_MAX])
        self._points.append((now, values))
        return {"at": now, "values": values}

    def plain(self) -> list[dict[str, Any]]:
        """All points."""
        return [{"at": at, "values": values} for at, values in self._points]
