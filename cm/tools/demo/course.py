# SPDX-License-Identifier: Apache-2.0
"""What happens in the fleet's demonstration: printed at once, and kept for its picture."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cm.wire.messages.fleet import BoardStatus

Picture = np.ndarray[Any, np.dtype[np.uint8]]


@dataclass
class Course:
    """What happened: `said` with the second of each, modes of boards by time (empty: gone), and pictures.

    `wanted`: the modes that were wanted of them, likewise.
    """

    begun: float = field(default_factory=time.monotonic)
    said: list[tuple[float, str, str]] = field(default_factory=list)
    modes: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    wanted: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    pictures: list[tuple[str, Picture]] = field(default_factory=list)
    ended: float = 0.0

    @property
    def now(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.begun

    def say(self, board: str, text: str) -> None:
        """Note it, and print it at once."""
        self.said.append((self.now, board, text))
        print(f"{self.now:7.3f} s  {board:6}  {text}", flush=True)

    def saw(self, board: str, status: BoardStatus | None) -> None:
        """A status, or that the board has gone."""
        self._into(self.modes, board, status.status.mode or "…" if status else "")

    def wants(self, board: str, mode: str) -> None:
        """What is wanted of a board now."""
        self._into(self.wanted, board, mode)

    def _into(self, lanes: dict[str, list[tuple[float, str]]], board: str, mode: str) -> None:
        lane = lanes.setdefault(board, [])
        if not lane or lane[-1][1] != mode:
            lane.append((self.now, mode))
