# SPDX-License-Identifier: Apache-2.0
"""Places in a queue that all clients share."""

from __future__ import annotations

import pytest

from cm.errors import Busy
from cm.server.rights.principal import NOBODY
from cm.server.shares.budget import Bounds, Budget
from cm.server.shares.places import Places
from cm.server.shares.registry import Budgets
from cm.server.shares.turns import Account, VirtualTime

CLOCK = VirtualTime()
ALL = Budgets(Bounds(0, 0), lambda _: NOBODY, lambda *_: None, lambda: ())
ANNA, BEN = Account("uid:1", CLOCK), Account("uid:2", CLOCK)


def client(name: str, account: Account) -> Budget:
    return Budget(name, Bounds(0, 0), ALL, account)


def taken(places: Places, who: Budget) -> int:
    """How many more it gets."""
    for count in range(100):
        try:
            places.take(who)
        except Busy:
            return count
    raise AssertionError("no bound")


def test_a_client_leaves_some_to_others_and_its_account_some_to_other_accounts() -> None:
    places = Places(16, "changes")
    assert taken(places, client("pid 1", ANNA)) == 12
    assert [taken(places, client(f"pid {i}", ANNA)) for i in range(2, 6)] == [1, 1, 0, 0]
    assert [taken(places, client(f"pid {i}", BEN)) for i in range(6, 9)] == [1, 0, 0]
    assert taken(places, client("key laptop", Account("key:laptop", CLOCK))) == 1
    assert taken(places, client("key other", Account("key:other", CLOCK))) == 0


def test_a_place_that_is_given_back_can_be_taken_again() -> None:
    places, one = Places(8, "changes"), client("pid 1", ANNA)
    held = [places.take(one) for _ in range(6)]
    with pytest.raises(Busy, match="changes: 6 of pid 1, 6 of uid:1, 6 of all wait or run, of 8"):
        places.take(one)
    for give_back in held:
        give_back()
    assert taken(places, one) == 6
