# SPDX-License-Identifier: Apache-2.0
"""Who pays for what is done for several at once."""

from __future__ import annotations

from collections import Counter

from cm.server.shares.bill import Bill


class Client:
    """One that pays."""

    def __init__(self, name: str, paid: Counter[str]) -> None:
        self._name = name
        self._paid = paid

    def charge(self, nanoseconds: int) -> None:
        self._paid[self._name] += nanoseconds


def charged(nanoseconds: int, *came: str) -> Counter[str]:
    """What everyone pays."""
    paid = Counter[str]()
    bill = Bill(lambda name: Client(name, paid))
    for name in came:
        bill.add(name)
    bill.charge(nanoseconds)
    return paid


def test_everyone_pays_by_how_often_it_came() -> None:
    assert charged(1000, "a", "b", "a", "a") == {"a": 750, "b": 250}


def test_nobody_pays_for_those_who_are_not_known() -> None:
    assert charged(1000, "a", "", "", "") == {"a": 250}


def test_where_nobody_came_nobody_pays() -> None:
    assert charged(1000) == {}
