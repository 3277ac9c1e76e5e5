# SPDX-License-Identifier: Apache-2.0
"""Leases end with the process that holds them, or are not granted if its end could not be noticed."""

from __future__ import annotations

import errno
import logging
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_support import Clock

from cm.manager.access.leases import Leases
from cm.server.lease_watch import LeaseWatch, Unwatched
from cm.server.sockets import Loop
from cm.wire.messages.requests import BreakLease, ReleaseLease, RenewLease, TakeLease


class Watch:
    """Leases, the watch of their holders, and the clock of both."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.leases = Leases(self.clock)
        self.loop = Loop()
        self.holders = LeaseWatch(self.loop, self.leases)

    def take(self, seconds: float = 30.0, scope: str = "board") -> str:
        request = TakeLease(scope=scope, exclusive=True, seconds=seconds, pid=os.getpid())
        info = self.leases.request(request)
        self.holders.follow(info, request)
        return info.id

    def close(self) -> None:
        self.holders.close()
        self.loop.close()


@pytest.fixture
def watch() -> Iterator[Watch]:
    made = Watch()
    yield made
    made.close()


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("error", [errno.EMFILE, errno.ENFILE, errno.ENOMEM])
def test_a_lease_whose_holder_cannot_be_watched_is_refused_and_keeps_no_client_out(
    watch: Watch, error: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> int:
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(os, "pidfd_open", fail)
    with pytest.raises(Unwatched, match="cannot be watched"):
        watch.take()
    monkeypatch.undo()
    watch.leases.check(("board",))
    assert watch.leases.holds(watch.take())


def test_a_lease_is_refused_where_the_loop_takes_no_more(watch: Watch, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "no more watches")

    monkeypatch.setattr(watch.loop, "add", fail)
    before = descriptors()
    with pytest.raises(Unwatched):
        watch.take()
    monkeypatch.undo()
    assert descriptors() == before
    watch.leases.check(("board",))


def test_expired_leases_cost_no_descriptors(watch: Watch) -> None:
    watch.take(seconds=1.0)
    before = descriptors()
    for _ in range(20):
        watch.clock.ahead += 2.0
        watch.take(seconds=1.0)
    assert descriptors() == before


def test_the_holder_of_a_lease_that_was_given_back_is_watched_no_more(
    watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    removed: list[int] = []

    def note(fd: int) -> None:
        os.fstat(fd)  # before it is closed, when its number may be another's
        removed.append(fd)

    monkeypatch.setattr(watch.loop, "remove", note)
    request = ReleaseLease(watch.take())
    watch.holders.follow(watch.leases.request(request), request)
    assert len(removed) == 1


def test_a_lease_of_a_process_that_has_died_is_dropped_at_once(watch: Watch) -> None:
    child = subprocess.Popen(["true"])
    child.wait()
    request = TakeLease(scope="board", exclusive=True, pid=child.pid)
    watch.holders.follow(watch.leases.request(request), request)
    watch.leases.check(("board",))


def test_a_lease_ends_when_its_holder_dies_or_its_time_is_over_though_nobody_asks(watch: Watch) -> None:
    with subprocess.Popen(["sleep", "60"]) as child:
        request = TakeLease(scope="region:a", exclusive=True, pid=child.pid)
        watch.holders.follow(watch.leases.request(request), request)
        before = descriptors()
        watch.take(0.01, "region:b")
        watch.leases.on_change = lambda: watch.leases.held() or watch.loop.stop()
        child.kill()
        watch.loop.run()
    assert descriptors() == before - 1


def test_who_takes_gives_back_and_breaks_a_lease_is_in_the_log(watch: Watch, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "cm")
    take = TakeLease("board", holder="bench", pid=os.getpid())
    lease = watch.leases.request(take)
    for request in (take, RenewLease(lease.id), ReleaseLease(lease.id), BreakLease(7)):
        watch.holders.follow(lease, request, "pid 10")
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [
        ("INFO", "lease on board taken by pid 10 for bench"),
        ("INFO", "lease on board given back by pid 10 for bench"),
        ("WARNING", "lease 7 on board, of bench, was broken by pid 10"),
    ]
