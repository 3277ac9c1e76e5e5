# SPDX-License-Identifier: Apache-2.0
"""How commands reach a manager, and how they show its answers."""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from enum import Enum
from typing import TYPE_CHECKING, Any

from cm.errors import NotFound, Timeout

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.wire.messages.status import Status

_PAUSE = 0.1  # seconds between two tries


def connected(args: argparse.Namespace) -> Board:
    """The manager that ``--runtime-dir`` or ``--connect`` names, or this machine's."""
    from cm.client.board import connect  # here: a completed name or a help text needs no client

    return connect(args.connect, runtime_dir=args.runtime_dir, keys=args.keys)


def awaited(args: argparse.Namespace, seconds: float) -> Board:
    """The same, tried until one answers. Raises what the last try raised after `seconds`."""
    end = time.monotonic() + seconds
    while True:
        try:
            return connected(args)
        except (NotFound, Timeout):
            if time.monotonic() > end:
                raise
            time.sleep(_PAUSE)


def settled(board: Board, seconds: float) -> Status:
    """The first status that tells of no change under way. Raises Timeout after `seconds` without a new one."""
    with board.watch(timeout=seconds) as statuses:
        return next(status for status in statuses if not status.fpga_busy)


def plain(value: Any) -> Any:
    """A frozen message as what JSON knows."""
    return asdict(value, dict_factory=lambda pairs: {k: _enum(v) for k, v in pairs})


def _enum(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def number(text: str) -> int:
    """An integer as people write them: 2, 0x1f, 0b101. Raises ValueError."""
    return int(text, 0)
