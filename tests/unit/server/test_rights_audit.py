# SPDX-License-Identifier: Apache-2.0
"""Who did what, in the log: once for a burst, and in lines that outsiders cannot forge."""

from __future__ import annotations

import logging
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.cli.serve import Lines
from cm.errors import Forbidden
from cm.manager.touched import Scene
from cm.server.requests import BY_KIND
from cm.server.rights.admission import Gate
from cm.server.rights.audit import BURST, Audit, described
from cm.server.rights.model import Access
from cm.server.rights.policy import Users
from cm.server.rights.principal import Principal, of_process
from cm.wire.messages import requests as rq


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def messages(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records]


def test_the_first_of_a_burst_is_reported_at_once_and_the_others_as_one(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "cm.audit")
    clock = Clock()
    audit = Audit(clock)
    for _ in range(1000):
        audit.note("a", "WriteReg", lambda: "anna: WriteReg focus")
    audit.note("b", "WriteReg", lambda: "ben: WriteReg focus")
    audit.flush()
    assert messages(caplog) == ["anna: WriteReg focus", "ben: WriteReg focus"]
    clock.now += BURST
    audit.flush()
    audit.flush()
    assert messages(caplog)[2:] == ["anna: WriteReg focus: 999 more within 10 s"]
    audit.note("a", "WriteReg", lambda: "anna: WriteReg zoom")
    assert messages(caplog)[3:] == ["anna: WriteReg zoom"]


def test_however_many_there_are_the_log_has_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "cm.audit")
    clock = Clock()
    audit, more = Audit(clock), "more is going on than is logged line by line"
    for _ in range(2):
        for number in range(10_000):
            audit.note(f"client {number}", "enter", lambda: "refused")
        assert (messages(caplog)[:512], messages(caplog)[512:]) == (["refused"] * 512, [more])
        clock.now += BURST
        audit.flush()
        assert messages(caplog)[513:] == [f"{more}: 9487 more within 10 s"]
        caplog.clear()


def test_a_request_is_described_by_what_it_changes() -> None:
    who = of_process("ipc", 1000, 1000, 7)
    assert described(who, rq.ChangeMode("camera", "edge")) == "user (uid 1000, pid 7): ChangeMode camera/edge"
    assert described(who, rq.ChangeMode("X1")).endswith(": ChangeMode X1")
    assert described(who, rq.ChangeMode(name_or_mode="edge")).endswith(": ChangeMode edge")
    writes = tuple(rq.RegWrite(f"r{i}", i) for i in range(9))
    assert described(who, rq.WriteReg(writes)).endswith("WriteReg r0, r1, r2, r3 and 5 more")
    assert described(who, rq.WriteData("to_pl", b"secret")).endswith("WriteData to_pl")
    assert described(who, rq.ReleaseLease("")).endswith("ReleaseLease")


def test_a_refusal_and_what_changes_something_are_reported_and_a_look_is_not(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "cm.audit")
    users = Users(lambda _: "anna", lambda *_: (), 500)
    gate = Gate(Access(users={"anna": ("operate",)}), users)
    anna = of_process("ipc", 1000, 1000, 7).id
    scene: Any = Scene(None, None, lambda _: None, {})  # type: ignore[arg-type, return-value]

    def admit(request: Any) -> None:
        gate.admit(anna, request, BY_KIND[type(request)].right, lambda: scene)

    for request in (rq.ReadStatus(), rq.TakeLease("board"), rq.ReadReg(("zoom",))):
        admit(request)
    with pytest.raises(Forbidden) as refused:
        admit(rq.RemoveConfig("camera"))
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("INFO", "anna (uid 1000, pid 7): TakeLease board"),
        ("WARNING", f"refused: {refused.value}"),
    ]
    assert str(refused.value).startswith("anna (uid 1000, pid 7) has no right to cm_write_config")


@given(st.text(), st.text())
def test_nothing_from_outside_begins_a_line_of_the_log(name: str, word: str) -> None:
    who = Principal("x", "curve", name=name, key="k" * 40)
    record = logging.LogRecord(
        "cm", logging.INFO, "", 0, "%s said %s", (described(who, rq.ReadConfig(word)), word), None
    )
    first, *rest = Lines(journal=False).format(record).split("\n")
    assert first.startswith("cm serve: ")
    assert all(line.startswith("    ") for line in rest)
    assert all(c.isprintable() or c == "\t" for line in (first, *rest) for c in line)


def test_a_forged_ready_line_does_not_count() -> None:
    record = logging.LogRecord("cm", logging.INFO, "", 0, "unknown topic %s", ("x\ncm serve: ready at /run/cm",), None)
    assert "\ncm serve: ready" not in Lines(journal=False).format(record)
