# SPDX-License-Identifier: Apache-2.0
"""A region's identity is read once it is connected; while it is still in reset, it reads as 0."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from cm.manager.errors import IdentityMismatch
from cm.manager.execution.transaction import IDENTITY_READS, check_identity
from cm.manager.state.board_state import RegionEvent

EXPECTED = 0x5D27_8DE1


def asked(*answers: int) -> tuple[Any, Any, list[object]]:
    """A context whose register gives these values, and then repeats the last one; a step; what was reported."""
    left, told = list(answers), []
    registers = SimpleNamespace(read_address=lambda address, width: left.pop(0) if len(left) > 1 else left[0])
    run = SimpleNamespace(
        tools=SimpleNamespace(registers=registers), region_event=lambda name, event: told.append((name, event))
    )
    identity = SimpleNamespace(base_address=0x4000_0000, offset=0x10C, width=32)
    step = SimpleNamespace(
        region=SimpleNamespace(name="prr0", identity=identity), module=SimpleNamespace(name="edge", identity=EXPECTED)
    )
    return run, step, told


LATE = [0] * (IDENTITY_READS - 1)


@pytest.mark.parametrize(
    ("answers", "refused"),
    [
        ([EXPECTED], ""),
        ([0, EXPECTED], ""),
        ([*LATE, EXPECTED], ""),  # it leaves its reset late
        ([*LATE, 0, EXPECTED], "0x0"),
        ([0, 0x77, EXPECTED], "0x77"),  # another module, at once
    ],
)
def test_a_region_is_waited_for_until_it_answers(answers: list[int], refused: str) -> None:
    run, step, told = asked(*answers)
    if not refused:
        check_identity(run, step)
        assert told == []
        return
    with pytest.raises(
        IdentityMismatch, match=rf"^region prr0 answers {refused} at its identity register; module edge is"
    ):
        check_identity(run, step)
    assert told == [("prr0", RegionEvent.LOSE)]
