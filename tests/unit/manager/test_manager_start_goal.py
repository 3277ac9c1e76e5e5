# SPDX-License-Identifier: Apache-2.0
"""Where a manager takes the board at its start, and how many accesses a register takes: no board, no files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from cm.manager.access.register_bus import RegisterBus
from cm.manager.inputs import Window
from cm.manager.recovery import Destination, destination
from cm.manager.state.board_state import BoardState
from cm.manager.state.record import Pending
from cm.schema import loads
from cm.schema.model import Access, Config, Register


def config(name: str, kind: str) -> Config:
    return loads(f"config:\n  name: {name}\n  type: {kind}\n  modes: {{one: {{}}, two: {{}}}}\n")


PARTIAL, OTHER, FULL = config("part", "partial"), config("other", "partial"), config("whole", "full")
ALL = {"part": PARTIAL, "other": OTHER, "whole": FULL}


def pending(from_config: str | None, from_mode: str | None, from_static: str | None = None) -> Pending:
    return Pending(7, "other", "two", from_config, from_mode, from_static=from_static)


def test_a_board_that_is_in_a_mode_stays_in_it() -> None:
    assert destination(BoardState("part", "two"), None, ALL) == Destination(PARTIAL, "two")
    assert destination(BoardState("part", "two"), pending("whole", "one"), ALL) == Destination(PARTIAL, "two")


@pytest.mark.parametrize("state", [BoardState(), BoardState("gone", "one"), BoardState("part", "gone")])
def test_without_a_mode_that_is_served_there_is_nowhere_to_go(state: BoardState) -> None:
    assert destination(state, None, ALL) is None


@pytest.mark.parametrize(
    ("cut", "there"),
    [
        (pending("whole", "one"), Destination(FULL, "one")),
        (pending("part", "two", "whole"), Destination(PARTIAL, "two", "whole")),
        (pending("part", "two"), None),
        (pending("part", "two", "gone"), None),
        (pending("part", "gone", "whole"), None),
        (pending("part", None, "whole"), None),
        (pending("gone", "one", "whole"), None),
        (pending(None, None), None),
    ],
)
def test_a_change_that_lost_the_image_goes_back_if_that_is_served(cut: Pending, there: Destination | None) -> None:
    assert destination(BoardState(), cut, ALL) == there


def test_a_known_configuration_in_no_mode_is_not_left_for_the_one_before() -> None:
    assert destination(BoardState("part", None), pending("whole", "one"), ALL) is None


# ---- accesses ------------------------------------------------------------------------------------------


class Counted:
    """A device that records its accesses."""

    def __init__(self, cells: Mapping[int, int]) -> None:
        self.cells, self.done = dict(cells), list[tuple[str, int]]()

    def window(self, address: int, width: int) -> Window:
        device: Any = self
        return Window(device, 0, address)

    def read(self, offset: int, width: int = 32, number: int = 0) -> int:
        self.done.append(("read", offset))
        return self.cells[offset]

    def write(self, offset: int, value: int, width: int = 32, number: int = 0) -> None:
        self.done.append(("write", value))


@pytest.mark.parametrize(
    ("access", "width", "mask", "last", "done"),
    [
        (Access.RW, 32, 0xFFFFFFFF, None, [("write", 5)]),
        (Access.RW, 8, 0xFF, None, [("write", 5)]),
        (Access.RW, 32, 0xF, None, [("read", 16), ("write", 0xA5)]),
        (Access.WO, 32, 0xF, 0xB3, [("write", 0xB5)]),
        (Access.WO, 32, 0xF, None, [("write", 0x5)]),
        (Access.W1C, 32, 0xF, 0xB3, [("write", 0x5)]),
    ],
)
def test_other_bits_are_read_only_where_they_matter(
    access: Access, width: int, mask: int, last: int | None, done: list[tuple[str, int]]
) -> None:
    device: Any = Counted({16: 0xA3})
    register = Register("r", 16, 0, width=width, access=access)
    assert RegisterBus(device).write(register, 5, mask, last) == done[-1][1]
    assert device.done == done
