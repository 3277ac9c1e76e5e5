# SPDX-License-Identifier: Apache-2.0
"""Regions that are left cut off."""

from __future__ import annotations

from collections.abc import Iterable

from cm.errors import CmError
from cm.manager.access.decoupler import drive
from cm.manager.access.register_bus import RegisterAccess
from cm.manager.execution.board import Board
from cm.manager.state.table import RegionEvent, RegionPhase
from cm.schema.model import Region


def abandon(board: Board, registers: RegisterAccess, regions: Iterable[Region]) -> list[str]:
    """After a failed way back: cut off every region that is not ready.

    Returns a sentence for each that could not be cut off. A device that may not be configured is not
    accessed at all: its bus would not answer, and the processor would hang.
    """
    problems = []
    for region in regions:
        if board.state.region(region.name).phase is RegionPhase.READY:
            continue
        try:
            if region.decoupler and not board.state.static_lost:
                drive(registers, region.decoupler, cut=True)
        except (CmError, OSError) as error:
            problems.append(f"{region.name} could not be decoupled: {error}")
        _mark_failed(board, region.name)
    return problems


def _mark_failed(board: Board, name: str) -> None:
    board.update(lambda state: state.with_region(name, state.region(name).after(RegionEvent.ABANDON)))
