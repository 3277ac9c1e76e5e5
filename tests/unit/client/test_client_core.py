# SPDX-License-Identifier: Apache-2.0
"""Flows of the clients' core, run without sockets: what they wait for, and when they have enough."""

from __future__ import annotations

from typing import Any

import pytest

from cm.client.core import calls, uploads
from cm.client.core.change import loading
from cm.client.core.effects import AskBeside, Receive
from cm.client.errors import RequestInvalid
from cm.wire.encode import encode_status
from cm.wire.messages.status import ChangeInfo, ErrorInfo, Progress, Status

CALL = calls.load("camera", "edge", wait=True, queue=True, force=False, lease="")
UNDER_WAY = Status("camera", "", fpga_busy=True, progress=Progress(7, "camera", "edge", "load", "prr0", 1, 2, 0.5))
ENDED = Status("camera", "edge", last_change=7)


def message(status: Status) -> list[Any]:
    return list(encode_status(status))


@pytest.mark.parametrize("overtaken", [False, True], ids=["in order", "reply first"])
def test_a_load_with_progress_waits_for_what_is_missing_and_for_nothing_more(overtaken: bool) -> None:
    told: list[Progress] = []
    flow = loading(CALL, None, object(), told.append)  # type: ignore[arg-type]
    assert isinstance(next(flow), Receive)
    asked = flow.send(message(Status("camera", "default", last_change=6)))
    assert isinstance(asked, AskBeside)
    if not overtaken:
        for status in (UNDER_WAY, ENDED):
            asked.take(message(status))
    waits: list[Any] = [message(UNDER_WAY), message(ENDED)] if overtaken else []
    answer: Any = ChangeInfo(7, done=True, seconds=0.25)
    while waits:
        assert isinstance(flow.send(answer), Receive)
        answer = waits.pop(0)
    with pytest.raises(StopIteration) as end:  # it waits for nothing more
        flow.send(answer)
    assert end.value.value == 0.25
    assert [progress.step for progress in told] == ["load"]


def test_a_manager_without_uploads_gets_everything_in_one_message() -> None:
    flow = uploads.upload(bytes(10 << 20))
    next(flow)
    with pytest.raises(StopIteration) as ended:
        flow.throw(RequestInvalid(ErrorInfo("invalid_request", "unknown topic 'cm_upload'; topics are cm_status")))
    assert ended.value.value == ""
