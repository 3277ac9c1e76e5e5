# SPDX-License-Identifier: Apache-2.0
"""The node's endpoints over DDS: what closing waits for."""

from __future__ import annotations

import sys
import threading
from types import FrameType

import pytest

pytest.importorskip("cyclonedds.domain")

from dds_support import PATIENCE, Peer
from manager_process import until
from ros_peer import unanswered

PLAN = "cm_interfaces/srv/Plan"


def test_closing_does_not_wait_for_answers_that_never_come() -> None:
    """More of them than are worked on at a time, so that the thread that takes requests waits, too."""
    server, client = Peer(), Peer()
    with unanswered(server.transport, "/plan", PLAN) as asked:
        plan = client.client("/plan", PLAN)
        for _ in range(32):
            plan.send({})
            assert asked.acquire(timeout=PATIENCE)
        plan.send({})
        until(lambda: _runs("services", "service.py"), PATIENCE)
        closing = threading.Thread(target=server.close, daemon=True)
        closing.start()
        closing.join(timeout=PATIENCE)
        assert not closing.is_alive()
    client.close()


def _runs(name: str, file: str) -> bool:
    """Whether a thread of that name is in a function of that file."""
    frames = sys._current_frames()
    idents = [thread.ident for thread in threading.enumerate() if thread.name == name]
    return any(_is_in(frames.get(ident), file) for ident in idents if ident is not None)


def _is_in(frame: FrameType | None, file: str) -> bool:
    while frame is not None and not frame.f_code.co_filename.endswith(f"dds/{file}"):
        frame = frame.f_back
    return frame is not None
