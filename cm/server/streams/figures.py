# SPDX-License-Identifier: Apache-2.0
"""Figures from streams' counters: totals, an open one's rate and median latency, and why a transfer failed."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from cm.device.data_plane import StreamCounts, StreamSetup
from cm.wire.messages.status import ErrorInfo


def median(values: Sequence[int]) -> int:
    """Return the median; 0 for no values. (Importing `statistics` would cost half a MiB.)"""
    return sorted(values)[len(values) // 2] if values else 0


def rate(counts: StreamCounts) -> float:
    """Return the frames per second over the last second."""
    now = time.monotonic_ns()
    recent = [t for t in counts.at_ns if t > now - 1_000_000_000]
    return (
        (len(recent) - 1) * 1e9 / (recent[-1] - recent[0])
        if len(recent) > 1 and recent[-1] > recent[0]
        else float(len(recent))
    )


def transfer_error(counts: StreamCounts, setup: StreamSetup) -> ErrorInfo | None:
    """Say why a transfer last failed; None if none has."""
    if not counts.error:
        return None
    text = f"a transfer of {setup.length} bytes failed: {os.strerror(counts.error)}"
    if counts.error == errno.EIO and not setup.write:
        text += "; so ends a packet that is longer than the frame, and an error of the bus"
    return ErrorInfo("transfer_failed", text)


class Moved(NamedTuple):
    """What a stream has moved."""

    frames: int = 0
    dropped: int = 0
    errors: int = 0
    bytes: int = 0

    def plus(self, other: Moved) -> Moved:
        """Both together."""
        return Moved(*map(sum, zip(self, other, strict=True)))


class StreamTotals:
    """What streams moved before they were last opened: at that moment their own counters start at 0 again."""

    def __init__(self) -> None:
        self._ended: dict[str, Moved] = {}

    def add(self, stream: str, moved: Moved) -> None:
        """A stream was closed."""
        self._ended[stream] = self._ended.get(stream, Moved()).plus(moved)

    def with_ended(self, now: Mapping[str, Moved]) -> dict[str, Moved]:
        """Totals of every stream that ever ran: what it has moved since it was opened, and before."""
        return {name: self._ended.get(name, Moved()).plus(now.get(name, Moved())) for name in {**self._ended, **now}}
