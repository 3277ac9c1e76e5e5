# SPDX-License-Identifier: Apache-2.0
"""Which boards are not in their fleet's mode: as the status and the page say it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cm.networks.fleet.change import member
from cm.networks.fleet.change.coordinator import Outcome
from cm.networks.fleet.errors import sentence
from cm.networks.fleet.standing import difference, disagreeing, stands_apart
from cm.wire.messages.fleet import BoardStatus, ClockSync, Decision, FleetRecord
from cm.wire.messages.status import ErrorInfo, Status

RECORD = FleetRecord(
    "c1", member.PREPARED, "camera", "edge", "camera", "default", ("b1", "b2", "b3"), caller="anna", deadline=100.0
)
FAILED = replace(RECORD, state=member.FAILED, decision=Decision.KEEP, error=ErrorInfo("load_failed", "CRC"))


def status(record: FleetRecord | None, mode: str = "default", now: float = 50.0) -> BoardStatus:
    return BoardStatus(Status("camera", mode), clock=ClockSync(now_ns=int(now * 1e9)), fleet=record)


SAID = [
    (status(None), "", False),
    (status(RECORD), "change c1 of anna: prepared", False),
    (status(RECORD, now=101.0), "change c1 of anna: prepared, waits for b1, b2, b3 to say what was decided", True),
    (status(FAILED), "change c1 of anna was kept, but failed here: CRC", True),
    (status(FAILED, mode="edge"), "", False),  # somebody loaded it since
    (status(replace(RECORD, state=member.NEW, decision=Decision.KEEP), mode="edge"), "", False),
    (status(replace(RECORD, state=member.OPEN, decision=Decision.REVERT)), "", False),
    (
        status(replace(FAILED, state=member.STUCK, decision=Decision.REVERT), mode=""),
        "change c1 of anna was taken back, but this board could not go back: CRC",
        True,
    ),
]


@pytest.mark.parametrize(("board", "words", "apart"), SAID)
def test_a_board_says_why_it_is_not_where_its_fleet_is(board: BoardStatus, words: str, apart: bool) -> None:
    assert (difference(board), stands_apart(board)) == (words, apart)


def test_boards_that_hold_different_decisions_about_one_change_are_all_named() -> None:
    kept = status(replace(RECORD, state=member.NEW, decision=Decision.KEEP))
    back = status(replace(RECORD, state=member.OLD, decision=Decision.REVERT))
    found = disagreeing({"b1": kept, "b2": back, "b3": kept, "b4": ErrorInfo("no_answer", "it is gone")})
    assert found == dict.fromkeys(("b1", "b2", "b3"), "change c1 was decided differently: b1, b3: keep; b2: revert")
    assert disagreeing({"b1": kept, "b3": kept}) == {}


def test_a_board_that_took_no_part_in_what_the_others_kept_is_named_until_it_is_there() -> None:
    kept = replace(RECORD, state=member.NEW, decision=Decision.KEEP, members=("b1", "b2"))
    there = status(kept, mode="edge")
    why = "it took no part in change c1 of anna, which the others kept"
    assert disagreeing({"b1": there, "b2": status(None)}) == {"b2": why}
    earlier = replace(RECORD, id="c0", state=member.OLD, decision=Decision.REVERT, deadline=50.0)
    assert disagreeing({"b1": there, "b2": status(earlier)}) == {"b2": why}
    assert disagreeing({"b1": there, "b2": status(replace(earlier, deadline=200.0))}) == {}  # of a later change
    assert disagreeing({"b1": there, "b2": status(None, mode="edge")}) == {}
    assert disagreeing({"b1": there, "b2": ErrorInfo("no_answer", "it is gone")}) == {}


GONE = ErrorInfo("no_answer", "it is not in the fleet now")
BUSY = ErrorInfo("busy", "change c0 of carl is applied here")
NEW = replace(RECORD, state=member.NEW, decision=Decision.KEEP)


@pytest.mark.parametrize(
    ("outcome", "said"),
    [
        (
            Outcome("c1", Decision.REVERT, {}, {}, ("b1",), {"b1": BUSY, "b2": BUSY}),
            f"nothing was changed: b1, b2: {BUSY.message}",
        ),
        (
            Outcome("c1", Decision.REVERT, {}, {"b1": GONE}, ("b1",), {"b1": GONE}),
            f"nothing was changed as far as is known: b1: {GONE.message}",
        ),
        (
            Outcome("c1", Decision.KEEP, {"b1": NEW}, {"b2": GONE, "b3": GONE}, ("b1",), {"b2": GONE, "b3": GONE}),
            f"the fleet is in the new mode, but for b2, b3: {GONE.message}",
        ),
        (Outcome("c1", Decision.KEEP, {"b1": NEW}, {}, ("b1",), {}), "the fleet is in the new mode"),
    ],
)
def test_how_a_change_ended_is_one_sentence_that_says_nothing_twice(outcome: Outcome, said: str) -> None:
    assert sentence(outcome) == said
