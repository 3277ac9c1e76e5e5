# SPDX-License-Identifier: Apache-2.0
"""What a record's events tell together: changes by their steps, and who asked for them, or wrote."""

from __future__ import annotations

import time

import pytest
from recording_support import BEGAN, OFFSET, OPENED

from cm.errors import InvalidRequest
from cm.recording.reader import Event
from cm.recording.story import Story, of_record, stories
from cm.recording.times import time_in, until
from cm.recording.why import explain, fault
from cm.tools.replay.script import State, ended_states
from cm.wire.messages.status import (
    Audit,
    ErrorInfo,
    FrameInfo,
    Irq,
    PastChange,
    PrMode,
    Progress,
    RegionStatus,
    RegValue,
    RegValues,
    Status,
    StepTaken,
)
from cm.wire.records import FrameSeen, Gap

pytestmark = pytest.mark.networks

ANNA, S = "anna (uid 1001, pid 811)", 10**9


def status(sequence: int, mode: str, change: int, step: str = "", **more: object) -> Status:
    progress = Progress(change + 1, "camera", "edge", step, "prr0") if step else None
    known: dict[str, object] = {"started_ns": 1, "board": "kria", "regions": (RegionStatus("prr0", mode, "ready"),)}
    return Status("camera", mode, sequence=sequence, last_change=change, progress=progress, **{**known, **more})  # type: ignore[arg-type]


def told(*events: tuple[float, str, object]) -> Story:
    return of_record(OPENED, [Event(BEGAN + round(seconds * S), topic, value) for seconds, topic, value in events])


CHANGE = (
    (0.0, "cm_status", status(1, "default", 1)),
    (2.0, "cm_status", status(2, "default", 1, "decouple")),
    (2.1, "cm_status", status(3, "default", 1, "load")),
    (2.2, "cm_status", status(4, "default", 1, "load")),
    (2.5, "cm_status", status(5, "edge", 2, last_change_seconds=0.5)),
)
ASKED = Audit("ChangeMode", "cm_write_config", b"", ANNA, "uid:1001", 811, 3 * S, 3 * S + S // 2, change=2)


def test_a_change_is_seen_at_its_own_end_though_a_history_told_of_it_before() -> None:
    """A recorder asks for the history behind a status; the next changes may have begun or ended by then."""
    gone = PastChange(2, "camera", "edge", "camera", "default", 2 * S, 3 * S, steps=(StepTaken("load", "prr0", 2 * S),))
    failed = ErrorInfo("load_failed", "load edge into prr0")
    begun = PastChange(3, "camera", "edge", "camera", "edge", 4 * S, steps=(StepTaken("decouple", "prr0", 4 * S),))
    ended = PastChange(
        3, "camera", "edge", "camera", "edge", 4 * S, 5 * S, steps=(*begun.steps, *gone.steps), error=failed
    )
    broken = {"last_error": failed, "pr_mode": PrMode.ERROR}
    events = [
        *CHANGE,
        (2.6, "cm_status", status(5, "edge", 2, changes=(gone, begun))),
        (2.7, "cm_status", status(6, "edge", 2, "decouple")),
        (2.8, "cm_status", status(7, "edge", 2, "load")),
        (2.85, "cm_status", status(8, "edge", 3, **broken)),
        (
            2.86,
            "cm_status",
            status(8, "edge", 3, **broken, changes=(gone, ended, PastChange(4, "camera", "plain", ended_ns=6 * S))),
        ),
        (2.9, "cm_status", status(11, "plain", 4)),
    ]
    states: dict[int, State] = {}
    for story in stories(OPENED, [Event(BEGAN + round(seconds * S), topic, value) for seconds, topic, value in events]):
        ended_states(states, story, 1)
    assert {number: (state.place, state.pr_mode, state.error) for number, state in states.items()} == {
        2: ("camera/edge", "idle", ""), 3: ("camera/edge", "error", "load_failed"), 4: ("camera/plain", "idle", ""),
    }  # fmt: skip
    assert states[3].steps == (("decouple", "prr0"), ("load", "prr0"))


@pytest.mark.parametrize("audited", [(2.6, 1), (1.9, 0)], ids=["behind it", "before it"])
def test_a_change_is_put_together_from_its_statuses_and_the_audit(audited: tuple[float, int]) -> None:
    events = [*CHANGE, (audited[0], "cm_audit", ASKED)]
    (change,) = told(*sorted(events, key=lambda event: event[0])).changes
    assert (change.number, change.from_mode, change.mode, change.by, change.error) == (2, "default", "edge", ANNA, None)
    assert [(step.kind, step.subject) for step in change.steps] == [("decouple", "prr0"), ("load", "prr0")]
    assert change.ended_ns - change.begun_ns == S // 2


def test_how_long_a_step_took_is_not_known_from_statuses_alone() -> None:
    (line,) = explain(told(*CHANGE), "prr0")
    assert "how long the load took is not known" in line
    assert "who asked for it is not known" in line


def test_a_change_that_failed_is_the_fault() -> None:
    error = ErrorInfo("load_failed", "load edge into prr0 by icap: the CRC does not match")
    end = status(5, "default", 2, last_error=error, pr_mode=PrMode.ERROR)
    story = told(*CHANGE[:-1], (2.5, "cm_status", end), (2.6, "cm_audit", ASKED))
    assert story.changes[-1].error == error
    assert f"the CRC does not match [load_failed]; asked for by {ANNA}" in fault(story)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_write_is_whose_audit_has_its_generation(order: tuple[int, int]) -> None:
    both = (
        (3.0, "cm_read_reg", RegValues((RegValue("focus", 5),), "camera", "edge", 7)),
        (3.0, "cm_audit", Audit("WriteReg", "cm_write_reg", b"", ANNA, "uid:1001", 811, 3 * S, 4 * S, generation=7)),
    )
    story = told(CHANGE[0], *(both[at] for at in order))
    assert [(w.name, w.value, w.by, w.at_ns) for w in story.writes] == [("focus", 5, ANNA, 4 * S)]
    assert story.values == {"focus": 5}


def test_a_value_that_the_recorder_has_read_is_no_write() -> None:
    story = told(CHANGE[0], (1.0, "cm_read_reg", RegValues((RegValue("focus", 5),))))
    assert (story.writes, story.values) == ((), {"focus": 5})
    assert "Who wrote focus, and when, is not known" in explain(story, "focus")[0]


def test_another_manager_numbers_its_changes_anew() -> None:
    story = told(*CHANGE, (2.6, "cm_audit", ASKED), (9.0, "cm_status", status(1, "edge", 0, started_ns=2)))
    assert story.changes == ()


def test_frames_interrupts_and_gaps_are_counted() -> None:
    frames = [(n / 10, "cm_frame/camera", FrameSeen(FrameInfo("camera", n, n, 4))) for n in (1, 2, 5)]
    gap = Gap("", BEGAN, BEGAN + S, 12, cause="disk_full", text="the disk was full")
    story = told(CHANGE[0], *frames, (1.0, "cm_irq", Irq("done", 7, 2 * S)), (2.0, "cm_gap", gap))
    assert story.frames == {"camera": (3, 2)}
    assert story.interrupts["done"].count == 7
    assert "12 messages is missing (disk_full): the disk was full" in explain(story)[-1]


def test_times_are_of_the_day_or_since_the_beginning() -> None:
    assert time_in("+7.5", OPENED) == BEGAN + 7 * S + S // 2
    at = BEGAN // S * S + 30 * S
    assert time_in(time.strftime("%H:%M:%S", time.localtime(at / 1e9)), OPENED) == at
    assert time_in(time.strftime("%Y-%m-%dT%H:%M:%S.25", time.localtime(at / 1e9)), OPENED) == at + S // 4
    before = time.strftime("%H:%M:%S", time.localtime((BEGAN - 60 * S) / 1e9))
    assert time_in(before, OPENED) == BEGAN // S * S - 60 * S + 86_400 * S
    for text in ("noon", "+", "25:00:00", "+1e999"):
        with pytest.raises(InvalidRequest, match="is no time in a record"):
            time_in(text, OPENED)
    events = [Event(BEGAN + n * S, "cm_irq", None) for n in range(5)]
    assert len(list(until(events, OPENED, "+2"))) == 3
    with pytest.raises(InvalidRequest, match=r"'\+2' is before the record, which begins at .* \(\+4.0\)"):
        list(until(events[4:], OPENED, "+2"))
    assert len(list(until(events, OPENED, "+4.9"))) == 5  # a clock is told each second
    with pytest.raises(InvalidRequest, match=r"'\+5.1' is after the record, which ends at .* \(\+4.0\)"):
        list(until(events, OPENED, "+5.1"))
    assert OFFSET < BEGAN
