# SPDX-License-Identifier: Apache-2.0
"""Leases: exclusive and shared, expired and renewed, and what changes and writes they refuse."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from manager_schemas import written

from cm.errors import InvalidRequest
from cm.manager.access.leases import MAX_SECONDS, Leases, UnknownLease, leases_concerned
from cm.manager.errors import HeldBy
from cm.wire.messages.requests import BreakLease, ReleaseLease, RenewLease, TakeLease
from cm.wire.messages.status import LeaseInfo


class Clock:
    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def leases(clock: Clock) -> Leases:
    return Leases(clock)


def take(leases: Leases, scope: str, exclusive: bool = True, seconds: float = 10.0, holder: str = "anna") -> LeaseInfo:
    return leases.request(TakeLease(scope=scope, exclusive=exclusive, seconds=seconds, holder=holder))


def test_all_may_see_whose_process_holds_a_lease(leases: Leases) -> None:
    leases.request(TakeLease("registers:led", True, 10.0, "anna", pid=77), "peer")
    (told,) = leases.told()
    assert (told.scope, told.exclusive, told.holder, told.client, told.pid) == (
        "registers:led", True, "anna", "peer", 77
    )  # fmt: skip


def kept_off(call: Callable[[], object]) -> bool:
    try:
        call()
    except HeldBy:
        return True
    return False


@pytest.mark.parametrize(
    ("held", "asked", "refused"),
    [
        ("board", "region:prr0", True),
        ("config", "registers:led", True),
        ("region:prr0", "region:prr0", True),
        ("region:prr0", "region:prr1", False),
        ("region:prr0", "board", True),
        ("registers:led", "registers:scratch", False),
    ],
)
def test_a_lease_keeps_others_off_what_contains_it_or_is_in_it(
    leases: Leases, held: str, asked: str, refused: bool
) -> None:
    mine = take(leases, held)
    assert kept_off(lambda: leases.check((asked,))) is refused
    leases.check((asked,), mine.id)
    assert kept_off(lambda: take(leases, asked, holder="bert")) is refused


def test_the_refusal_names_the_holder_and_how_long(leases: Leases, clock: Clock) -> None:
    take(leases, "region:prr0", seconds=30)
    clock.now += 12
    with pytest.raises(HeldBy, match=r"region:prr0 is held by anna \(alone\), for 18 s more"):
        leases.check(("region:prr0",))


def test_shared_leases_stand_beside_each_other_and_keep_off_clients_without_one(leases: Leases) -> None:
    first, second = (take(leases, "region:prr0", exclusive=False, holder=name) for name in ("anna", "bert"))
    leases.check(("region:prr0",), first.id)
    leases.check(("region:prr0",), second.id)
    assert kept_off(lambda: leases.check(("region:prr0",)))
    assert kept_off(lambda: take(leases, "region:prr0", exclusive=True, holder="cora"))


def test_a_shared_lease_on_something_else_does_not_count(leases: Leases) -> None:
    take(leases, "region:prr0", exclusive=False)
    other = take(leases, "region:prr1", holder="bert")
    assert kept_off(lambda: leases.check(("region:prr0",), other.id))


def test_a_lease_ends_after_its_time_unless_it_is_renewed(leases: Leases, clock: Clock) -> None:
    mine = take(leases, "board", seconds=10)
    clock.now += 9
    leases.request(RenewLease(mine.id, 10))
    clock.now += 9
    assert kept_off(lambda: leases.check(("board",)))
    clock.now += 1
    leases.check(("board",))
    with pytest.raises(UnknownLease):
        leases.request(RenewLease(mine.id, 10))


def test_a_lease_ends_when_it_is_given_back_or_broken_or_its_holder_dies(leases: Leases) -> None:
    mine = take(leases, "board")
    leases.request(ReleaseLease(mine.id))
    leases.check(("board",))
    take(leases, "board")
    (told,) = leases.told()
    assert leases.request(BreakLease(told.number)).scope == "board"
    with pytest.raises(UnknownLease):
        leases.request(BreakLease(told.number))
    other = take(leases, "board")
    assert leases.drop(other.id)
    assert not leases.drop(other.id)
    leases.check(("board",))


@pytest.mark.parametrize("scope", ["", "region", "region:", "board:x", "prr0"])
def test_an_invalid_scope_is_refused(leases: Leases, scope: str) -> None:
    with pytest.raises(InvalidRequest, match="region:NAME"):
        take(leases, scope)


def test_no_lease_lasts_for_ever(leases: Leases) -> None:
    with pytest.raises(InvalidRequest, match="renewed"):
        take(leases, "board", seconds=MAX_SECONDS + 1)


@pytest.mark.parametrize(
    ("held", "mode", "refused"),
    [
        ("board", "other", True),
        ("config", "other", True),
        ("region:prr0", "other", True),
        ("region:prr1", "other", False),  # that mode loads prr0 only
        ("region:prr1", "both", True),
        ("registers:gain", "other", True),  # lies in the region, and has a default
        ("registers:scratch", "other", False),
        ("registers:lamp", "lit", True),  # which that mode alone writes
        ("registers:lamp", "other", False),
    ],
)
def test_a_change_is_refused_for_what_it_touches(
    leases: Leases, tmp_path: Path, held: str, mode: str, refused: bool
) -> None:
    config = written(tmp_path, ("duo",))["duo"]
    take(leases, held)
    assert kept_off(lambda: leases.check(leases_concerned(config, mode, loaded="duo"))) is refused
    assert kept_off(lambda: leases.check(leases_concerned(config, mode, loaded="whole")))
