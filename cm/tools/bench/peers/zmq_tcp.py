# SPDX-License-Identifier: Apache-2.0
"""As `zmq_echo`, over the loopback's TCP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from cm.tools.bench.peers.zmq_echo import echo, near

__all__ = ["far", "near"]


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (any size)
    """The other end, at a free port."""
    echo("tcp://127.0.0.1:*", folder, ready)
