# SPDX-License-Identifier: Apache-2.0
"""The checker of histories finds what is wrong with them, and nothing in those that are right."""

from __future__ import annotations

import random
import tracemalloc

from fleet_history import NEVER, Operation, State, linearizable


def put(begun: float, ended: float, value: str, before: str | None = None) -> Operation:
    return Operation(begun, ended, "txn", expect=(("k", before),), puts=(("k", value),))


def get(begun: float, ended: float, value: str | None) -> Operation:
    return Operation(begun, ended, "get", () if value is None else (("k", value),))


def test_what_was_seen_while_it_changed_may_be_either() -> None:
    for seen in (None, "a"):
        assert linearizable([put(1, 4, "a"), get(2, 3, seen)])


def test_a_value_that_goes_back_is_found() -> None:
    assert not linearizable([put(1, 2, "a"), get(3, 4, "a"), get(5, 6, None)])
    assert not linearizable([put(1, 4, "a"), get(1, 2, "a"), get(3, 3.5, None)])  # even while it is put


def test_a_lost_update_is_found() -> None:
    assert not linearizable([put(1, 2, "a"), put(3, 4, "b")])  # both said that the key was absent
    assert linearizable([put(1, 2, "a"), put(3, 4, "b", "a")])


def test_what_has_no_end_may_have_happened_or_not_but_not_both() -> None:
    lost = put(1, NEVER, "a")
    assert linearizable([lost, get(2, 3, None), get(4, 5, "a")])
    assert linearizable([lost, get(2, 3, None)])
    assert not linearizable([lost, get(2, 3, "a"), get(4, 5, None)])


def test_a_stale_read_in_a_long_history_is_found_and_its_true_one_is_right() -> None:
    chance, history, now, state = random.Random(1), [], 0.0, ()
    for number in range(200):
        now += 1
        before: State = state
        if chance.random() < 0.3:
            last = dict(before).get("k")
            history.append(put(now, now + 0.5, str(number), last))
            state = (("k", str(number)),)
        else:
            history.append(Operation(now - chance.random() * 3, now + 0.9, "get", state))
    assert linearizable(history)
    writes = [n for n, each in enumerate(history) if each.kind == "txn"]
    stale = Operation(history[writes[9]].begun, history[writes[9]].ended + 0.1, "get", (("k", str(writes[3])),))
    assert not linearizable([*history, stale])


def test_what_a_long_history_takes_grows_with_its_length_and_no_faster() -> None:
    """Three hundred rounds are 60,000 operations."""

    def peak(length: int) -> int:
        history = [each for n in range(length) for each in (put(n, n + 1.5, str(n), str(n - 1) if n else None),)]
        history += [get(n + 0.5, n + 3.2, str(n + 1)) for n in range(length - 1)] + [put(3.0, NEVER, "x", "y")]
        tracemalloc.start()
        assert linearizable(history)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    assert peak(4000) < 6 * peak(1000)
