# SPDX-License-Identifier: Apache-2.0
"""The lease that reserves a board while a change of its fleet is open; records on disk."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from cm.client.errors import RequestFailed
from cm.networks.fleet.bridge import managed
from cm.networks.fleet.bridge.managed import HOLD, ManagedBoard
from cm.networks.fleet.bridge.records import Records
from cm.networks.fleet.change import member
from cm.wire.messages import requests as rq
from cm.wire.messages.fleet import Decision, FleetRecord
from cm.wire.messages.status import ErrorInfo, LeaseInfo

RECORD = FleetRecord("c1", member.PREPARED, "camera", "edge", "camera", "default", ("b1",), caller="anna")


class Manager:
    """What a relay would reach: it grants leases, and forgets them when it is restarted."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.known: set[str] = set()

    async def ask(self, call: Any, guest: str = "", timeout: float | None = None) -> Any:
        request = call.request
        self.asked.append((type(request).__name__, guest))
        if isinstance(request, rq.TakeLease):
            self.known.add(f"l{len(self.asked)}")
            return LeaseInfo(f"l{len(self.asked)}", "board", True, request.seconds)
        if request.id not in self.known:
            raise RequestFailed(ErrorInfo("not_found", "no such lease"))
        return None


def test_the_lease_is_renewed_in_time_and_taken_anew_where_the_manager_forgot_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [1000.0]
    monkeypatch.setattr(managed.time, "monotonic", lambda: now[0])
    manager = Manager()
    board = ManagedBoard(manager, Records(tmp_path), own_name=False)  # type: ignore[arg-type]

    async def course() -> None:
        await board.hold(RECORD)
        await board.keep_holding(RECORD)
        now[0] += HOLD / 2
        await board.keep_holding(RECORD)
        manager.known.clear()
        now[0] += HOLD / 2
        await board.keep_holding(RECORD)
        await board.release(RECORD)

    asyncio.run(course())
    assert [kind for kind, _ in manager.asked] == ["TakeLease", "RenewLease", "RenewLease", "TakeLease", "ReleaseLease"]
    assert {guest for _, guest in manager.asked} == {"zenoh:anna"}
    assert Records(tmp_path).lease("c1") == ""


def test_records_are_found_after_a_restart_and_the_last_is_known(tmp_path: Path) -> None:
    first = Records(tmp_path)
    first.write(RECORD)
    first.write(FleetRecord("c0", member.OPEN, decision=Decision.REVERT))  # another's: this board took no part
    again = Records(tmp_path)
    assert again.last() == RECORD
    assert again.read("c0") is not None
    assert again.read("c2") is None


def test_an_incomplete_record_counts_as_none(tmp_path: Path) -> None:
    Records(tmp_path).write(RECORD)
    (tmp_path / "c1.record").write_bytes(b"\xff\xff")
    assert Records(tmp_path).last() is None
    (tmp_path / "last").write_text("c9")  # killed before the record itself was there
    assert Records(tmp_path).last() is None
