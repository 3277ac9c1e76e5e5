# SPDX-License-Identifier: Apache-2.0
"""Leases: exclusive and shared, expired and renewed, and what changes and writes they refuse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from manager_schemas import written

from cm.errors import CmError
from cm.manager.access.leases import (
    MAX_SECONDS,
    Leases,
    check_scope_names_something,
    leases_concerned,
)
from cm.manager.errors import HeldBy
from cm.schema import loads
from cm.wire.messages.requests import (
    BreakLease,
    ReleaseLease,
    RenewLease,
    TakeLease,
)
from cm.wire.messages.status import LeaseInfo, LeaseStatus


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


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(CmError) as caught:
        call()
    return str(caught.value)


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


def out(number: int) -> str:
    """What its holder gives, and how others end it."""
    return f"; CM_LEASE=ID (lease=ID in Python) if it is yours; cm lease break {number} ends it (for administrators)"


def test_the_refusal_names_the_holder_how_long_and_the_ways_out(leases: Leases, clock: Clock) -> None:
    take(leases, "region:prr0", seconds=30)
    clock.now += 12
    leases.hold("region:prr1", "window 1", "peer", 7)
    take(leases, "registers:led", exclusive=False, holder="an\x1bna")
    take(leases, "registers:led", exclusive=False, holder="")
    texts = {scope: refusal(lambda scope=scope: leases.check((scope,))) for scope in ("region:prr0", "region:prr1")}
    assert texts == {
        "region:prr0": "region:prr0 is held by anna (alone), for 18 s more unless renewed" + out(1),
        "region:prr1": "region:prr1 is held by window 1 (alone), until that is given back" + out(2),
    }
    assert refusal(lambda: leases.check(("registers:led",))) == (
        "registers:led is held by an?na (shared), for 10 s more unless renewed" + out(3)
    )
    assert refusal(lambda: take(leases, "region:prr0")) == texts["region:prr0"]
    assert leases.statuses() == (
        LeaseStatus(1, "region:prr0", True, "anna", "", 0, 18.0),
        LeaseStatus(2, "region:prr1", True, "window 1", "peer", 7, 0.0),  # it has no end
        LeaseStatus(3, "registers:led", False, "an?na", "", 0, 10.0),
        LeaseStatus(4, "registers:led", False, "somebody", "", 0, 10.0),
    )


def test_shared_leases_stand_beside_each_other_and_keep_off_clients_without_one(leases: Leases) -> None:
    first, second = (take(leases, "region:prr0", exclusive=False, holder=name) for name in ("anna", "bert"))
    leases.check(("region:prr0",), first.id)
    leases.check(("region:prr0",), second.id)
    assert kept_off(lambda: leases.check(("region:prr0",)))
    assert kept_off(lambda: take(leases, "region:prr0", exclusive=True, holder="cora"))
    other = take(leases, "region:prr1", exclusive=False)
    assert kept_off(lambda: leases.check(("region:prr0",), other.id))  # which is one on something else


def test_a_lease_ends_after_its_time_unless_it_is_renewed(leases: Leases, clock: Clock) -> None:
    mine = take(leases, "board", seconds=9.5)
    clock.now += 9
    renewed = replace(mine, seconds=10.0)
    assert (leases.request(RenewLease(mine.id, 10.0)), leases.held()) == (renewed, (renewed,))
    clock.now += 9.5
    assert kept_off(lambda: leases.check(("board",)))
    assert (leases.holds(mine.id), leases.expire(), leases.any_held) == (True, 0.5, True)
    clock.now += 0.5
    leases.check(("board",))
    assert (leases.holds(mine.id), leases.expire(), leases.any_held, leases.statuses()) == (False, None, False, ())
    unknown = f"no lease {mine.id!r} is held; it may have ended after its time"
    assert refusal(lambda: leases.request(RenewLease(mine.id, 10))) == unknown
    leases.hold("board", "window 1", "peer", 7)
    clock.now += 10 * MAX_SECONDS
    assert (leases.expire(), len(leases.held())) == (None, 1)  # one without an end


def test_every_lease_that_comes_and_goes_is_told_once(leases: Leases, clock: Clock) -> None:
    told: list[int] = []
    leases.on_change = lambda: told.append(len(leases.held()))
    first = take(leases, "region:prr0", seconds=5)
    take(leases, "region:prr1", seconds=9)
    leases.request(RenewLease(first.id, 20))
    clock.now += 9
    assert (leases.expire(), leases.expire()) == (11.0, 11.0)
    leases.request(ReleaseLease(first.id))
    assert told == [1, 2, 1, 0]


def test_a_client_and_all_together_hold_no_more_leases_than_they_may(clock: Clock) -> None:
    leases = Leases(clock, most=3, each=2)

    def one(client: str) -> str:
        return leases.request(TakeLease("registers:led", False, seconds=10.0), client).id

    held = [one("anna"), one("anna")]
    assert refusal(lambda: one("anna")) == ("anna holds 2 leases, all together 2; 2 and 3 may be held (limits.leases)")
    held.append(one("bert"))
    assert refusal(lambda: one("")).startswith("this client holds 0 leases, all together 3; 2 and 3 may be held")
    leases.request(ReleaseLease(held[0]))
    one("")
    leases.renew(4, 3)
    one("anna")
    assert len(leases.held()) == 4


def test_the_processes_of_a_user_share_the_leases_that_it_may_hold(clock: Clock) -> None:
    leases = Leases(clock, most=3, each=2)
    for pid in (1, 2):
        leases.request(TakeLease("registers:led", False, seconds=10.0), f"pid {pid} (view)", "uid:1000")
    assert refusal(lambda: leases.request(TakeLease("registers:led"), "pid 3 (view)", "uid:1000")).startswith(
        "uid:1000 holds 2 leases"
    )
    leases.request(TakeLease("registers:led", False, seconds=10.0), "pid 4 (view)", "uid:1001")


def test_a_lease_ends_when_it_is_given_back_or_broken_or_its_holder_dies(leases: Leases) -> None:
    mine = take(leases, "board")
    leases.request(ReleaseLease(mine.id))
    leases.check(("board",))
    take(leases, "board")
    (told,) = leases.statuses()
    assert leases.request(BreakLease(told.number)).scope == "board"
    assert refusal(lambda: leases.request(BreakLease(told.number))) == (
        f"no lease has the number {told.number}; cm lease list"
    )
    other = take(leases, "board")
    assert leases.drop(other.id)
    assert not leases.drop(other.id)
    leases.check(("board",))


@pytest.mark.parametrize("scope", ["", "region", "region:", "board:x", "board:", "prr0", ":", "region "])
def test_an_invalid_scope_is_refused(leases: Leases, scope: str) -> None:
    assert refusal(lambda: take(leases, scope)) == (
        f"scope {scope!r}: it is one of board, config, region:NAME, registers:NAME, memories:NAME"
    )


def test_no_lease_lasts_for_ever(leases: Leases) -> None:
    for seconds in (MAX_SECONDS + 1, -1.0):
        assert refusal(lambda seconds=seconds: take(leases, "board", seconds=seconds)) == (
            f"a lease of {seconds} s: it can be held for up to 3600 s, then renewed"
        )
    assert take(leases, "region:prr0", seconds=MAX_SECONDS).seconds == MAX_SECONDS
    assert take(leases, "region:prr1", seconds=0).seconds == 30.0


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
    assert leases_concerned(config, mode, "whole") == ("config",)  # so a lease on anything keeps it off


CONFIG = loads("""
config:
  name: lab
  regions: [left]
  modules: {fir: {region: left, mmio: [{base_address: 0x2000, registers: {gain: {offset: 0}}}]}}
  registers: {led: {base_address: 0x1000, offset: 0}}
  memories: {log: {base_address: 0x5000, size: 64}, taps: {base_address: 0x6000, size: 64, region: left}}
  streams: {samples: {direction: mm2s, region: left, shape: [4]}}
  modes:
    one: {modules: [fir], registers: {lamp: {base_address: 0x1000, offset: 4}}}
    two: {memories: {late: {base_address: 0x7000, size: 64}}}
""")


BLOCKS = ["block", "block1", "block2"]


@pytest.mark.parametrize(
    ("scope", "refused"),
    [
        ("region:left", ""),
        ("registers:gain", ""),  # of a module
        ("registers:lamp", ""),  # of a mode
        ("memories:late", ""),
        ("memories:block", ""),  # defined at run time
        ("board", ""),
        ("registers", ""),  # which is no scope at all, and told otherwise
        ("region:lift", "; did you mean 'left'?"),
        ("registers:block", "; there are gain, lamp, led"),
        ("memories:gain", "; there are block, block1, block2, late, log, taps"),
        ("memories:blocks", "; did you mean 'block' or 'block2'?"),  # two are enough
    ],
)
def test_a_scope_that_would_keep_nobody_off_is_refused(scope: str, refused: str) -> None:
    if not refused:
        check_scope_names_something(scope, [CONFIG], BLOCKS)
        return
    text = f"scope {scope!r}: no configuration has {scope.partition(':')[2]!r}{refused}"
    assert refusal(lambda: check_scope_names_something(scope, [CONFIG], BLOCKS)) == text
