# SPDX-License-Identifier: Apache-2.0
"""How commands reach a manager, and how they show what it says."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from enum import Enum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cm.client.board import Board


def connected(args: argparse.Namespace) -> Board:
    """The manager that ``--runtime-dir`` or ``--connect`` names, or this machine's."""
    from cm.client.board import connect  # here: a completed name or a help text needs no client

    return connect(args.connect, runtime_dir=args.runtime_dir, keys=args.keys)


def plain(value: Any) -> Any:
    """A frozen message as what JSON knows."""
    return asdict(value, dict_factory=lambda pairs: {k: _enum(v) for k, v in pairs})


def _enum(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def number(text: str) -> int:
    """An integer as people write them: 2, 0x1f, 0b101. Raises ValueError."""
    return int(text, 0)
