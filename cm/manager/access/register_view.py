# SPDX-License-Identifier: Apache-2.0
"""What can be named in the mode that the board is in: where a name leads, and what may be written there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from cm.manager.state.board_state import LockedRegions, ManagerState
from cm.manager.state.table import BoardState, RegionPhase
from cm.messages.requests import RegWrite
from cm.schema.model import Access, BitField, Config, Register

_RO, _READY = Access.RO, RegionPhase.READY  # a look into an enum's class is not free


class Place(NamedTuple):
    """Where a name leads: a register, or one of its fields.

    Values from `low` to `high` may be written: to the bits of `mask`, `lsb` up. There are none where `low` is above.
    """

    register: Register
    field: BitField | None
    region: str | None
    address: int
    width: int
    low: int
    high: int
    lsb: int
    mask: int


Checked = tuple[Place, int, int]  # value and mask in the register's place


def place_of(register: Register, field: BitField | None) -> Place:
    """Where a name leads that was found."""
    bits = field.width if field is not None else register.width
    low, high, lsb, mask = 0, (1 << bits) - 1, 0, (1 << bits) - 1
    if field is not None:
        lsb, mask = field.lsb, field.mask
    else:
        low = max(low, register.minimum or 0)
        high = high if register.maximum is None else min(high, register.maximum)
    if register.access is _RO:
        low, high = 1, 0
    return Place(register, field, register.region, register.address, register.width, low, high, lsb, mask)


def plainly(place: Place, write: RegWrite) -> Checked | None:
    """A write of a number that may be written; None for all others, whatever is to be said of them.

    What `register_names.checked_write` says too, which takes four times as long to find it.
    """
    if write.mask is None and not write.named and place.low <= write.value <= place.high:
        return place, write.value << place.lsb, place.mask
    return None


class View:
    """What can be named in the mode that the board is in, what was named in it before, and what is free.

    It is made anew where the board holds something else, not with each value that is written.
    """

    __slots__ = ("_board", "_configs", "_locked", "config", "free", "mode", "places", "registers")

    def __init__(self, state: ManagerState, config: Config) -> None:
        self._configs, self._board, self._locked = state.configs, state.latest, state.locked
        self.config, self.mode = config, state.latest.mode
        self.registers: Mapping[str, Register] = config.visible_registers(self.mode)
        self.places: dict[str, Place] = {}
        regions = {register.region for register in self.registers.values()}  # and None for the static part
        self.free = {region for region in regions if is_free(state.latest, state.locked, region)}

    def still_holds(self, state: ManagerState) -> bool:
        """Whether it is true of what the board holds now."""
        then, now = self._board, state.latest
        if then is not now:
            if then.regions is not now.regions or then.mode != now.mode or then.config != now.config:
                return False
            self._board = now  # only values differ
        return self._configs is state.configs and self._locked is state.locked


def is_free(board: BoardState, locked: LockedRegions, region: str | None) -> bool:
    """Whether registers of a region (None: of the static part) may be accessed."""
    if region is None:
        return not locked.whole
    return board.region(region).phase is _READY and region not in locked
