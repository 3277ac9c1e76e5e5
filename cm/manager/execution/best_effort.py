# SPDX-License-Identifier: Apache-2.0
"""Recording on the way back, where it must not stand in the way."""

from __future__ import annotations

from cm.manager.errors import RecordFailed
from cm.manager.execution.board import Board
from cm.manager.state.steps import LoadStatic, Step
from cm.manager.state.table import BoardState


class BestEffort:
    """A board on the way back: that the record cannot be written does not keep it from the mode before.

    Whatever was touched, the last good record is of this change and says so: after a crash the board
    goes to the same mode before, by loading what that record does not say is there. Only a whole image
    is not begun without a record: registers of a device that is half loaded must not be accessed.
    """

    def __init__(self, board: Board) -> None:
        self._board = board
        self.update = board.update
        self.observed = board.observed
        self.took = board.took
        self.lock_regions = board.lock_regions
        self.progress = board.progress

    @property
    def state(self) -> BoardState:
        """What the board holds now."""
        return self._board.state

    def record(self, step: Step | None) -> None:
        """Write the state if that is possible. Raises RecordFailed before a whole image is loaded."""
        try:
            self._board.record(step)
        except RecordFailed:
            if isinstance(step, LoadStatic):
                raise
