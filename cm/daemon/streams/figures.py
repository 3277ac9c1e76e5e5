# SPDX-License-Identifier: Apache-2.0
"""Figures from an open stream's counters: its rate, its median latency, and why a transfer failed."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Sequence

from cm.device.data_plane import StreamCounts, StreamSetup
from cm.messages.status import ErrorInfo


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
