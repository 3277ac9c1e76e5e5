# SPDX-License-Identifier: Apache-2.0
"""What a change needs of whoever keeps the state, and the tools that its steps work with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from cm.manager.access.register_bus import RegisterAccess
from cm.manager.loaders import Loaders
from cm.manager.ports import Clock, DataPlane, Devices
from cm.manager.state.steps import Step
from cm.manager.state.table import BoardState
from cm.messages.status import Progress
from cm.schema.model import LoaderKind


class Board(Protocol):
    """Where the state lives and is recorded; shared with readers of registers."""

    @property
    def state(self) -> BoardState:
        """What the board holds now."""

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state by what `change` makes of it, in one piece."""

    def observed(self, kind: LoaderKind, length: int, seconds: float) -> None:
        """A load of `length` bytes took so long."""

    def took(self, step: Step, seconds: float) -> None:
        """A step took so long beside what a port took for its image."""

    def record(self, step: Step | None) -> None:
        """Write the state, and the step about to be taken, to the store. Raises RecordFailed."""

    def lock_regions(self, regions: frozenset[str], whole: bool = False) -> None:
        """From here on nobody else touches registers of these regions, or with `whole` any register."""

    def progress(self, progress: Progress) -> None:
        """Tell how far the change is."""


@dataclass(frozen=True, slots=True)
class Tools:
    """What the steps work with."""

    devices: Devices
    registers: RegisterAccess
    loaders: Loaders
    data_plane: DataPlane
    clock: Clock
