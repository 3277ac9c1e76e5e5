# SPDX-License-Identifier: Apache-2.0
"""Leases as everybody sees them: who holds which, how many, and how one is broken."""

from __future__ import annotations

import json
import os

import pytest
from manager_process import Manager

from cm.cli.main import main
from cm.client.errors import RequestBusy, RequestNotFound


def test_leases_are_listed_without_their_ids_and_broken_by_number(
    manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--runtime-dir", str(manager.runtime)]
    with manager.connected() as holder, manager.connected() as other, pytest.raises(RequestNotFound):  # noqa: PT012, SIM117
        with holder.lease("board", holder="a\x1b[31mcamera") as held:
            (told,) = other.status.leases
            assert (told.scope, told.exclusive, told.holder, told.pid) == ("board", True, "a?[31mcamera", os.getpid())
            assert told.client.startswith(f"pid {os.getpid()} (")
            assert 0 < told.seconds <= 30
            assert held.id not in repr(other.status)
            assert [client.leases for client in other.clients() if client.name == told.client] == [1]
            with pytest.raises(RequestBusy, match="camera"):
                other.load("camera", "edge_detection")
            assert main(["lease", "list", *where]) == 0
            assert "a?[31mcamera" in capsys.readouterr().out
            assert main(["lease", "list", "--json", *where]) == 0
            assert json.loads(capsys.readouterr().out)[0]["number"] == told.number
            assert main(["lease", "break", str(told.number), *where]) == 0
            assert "held no more" in capsys.readouterr().out
            other.load("camera", "edge_detection")
            assert main(["lease", "break", str(told.number), *where]) != 0
        # giving it back fails: it was broken


def test_a_lease_that_is_taken_given_back_broken_or_over_is_told_to_whoever_listens(manager: Manager) -> None:
    def next_with(held: int) -> None:
        for status in statuses:
            if len(status.leases) == held:
                assert status.sequence > seen[-1]
                seen.append(status.sequence)
                return

    with manager.connected() as holder, manager.connected() as listener, listener.watch(timeout=60) as statuses:
        seen = [next(iter(statuses)).sequence]
        lease = holder.lease("registers:led", seconds=60)
        with lease:
            next_with(1)
        next_with(0)
        lease = holder.lease("registers:led", seconds=60)
        lease.__enter__()
        next_with(1)
        holder.break_lease(holder.status.leases[0].number)
        next_with(0)
        holder.lease("registers:led", seconds=0.2).__enter__()
        next_with(1)
        next_with(0)  # its time is over, and nobody has asked for anything since
