# SPDX-License-Identifier: Apache-2.0
"""How the slots of a stream are shared out, and the memory for masters in the PL."""

from __future__ import annotations

import pytest

from cm.errors import Busy
from cm.server.streams.memory import MEMORIES, MemoryBudget
from cm.server.streams.peer import Peer
from cm.server.streams.slots import NoSlots, share

EACH = 64

GREEDY, NEW = Peer(10, "greedy"), Peer(20, "new")


def test_a_client_that_asks_for_all_gets_its_share_and_the_next_what_it_asks_for() -> None:
    assert share("camera", 255, GREEDY, [], EACH) == 64
    assert share("camera", 4, NEW, [(GREEDY, 64)], EACH) == 4


def test_the_same_process_gets_no_more_by_asking_again() -> None:
    assert share("camera", 60, GREEDY, [(GREEDY, 40)], EACH) == 24
    with pytest.raises(NoSlots, match=r"pid 10 \(greedy\) holds 64, of 256; one process gets 64"):
        share("camera", 4, GREEDY, [(GREEDY, 40), (GREEDY, 24)], EACH)


def test_the_last_slots_are_for_clients_without_any() -> None:
    others = [(Peer(pid, "reader"), 64) for pid in (1, 2, 3)] + [(Peer(4, "reader"), 42)]  # 234 of the 250 there are
    assert share("camera", 8, NEW, others, EACH) == 8
    with pytest.raises(NoSlots, match=r"pid 1 \(reader\) holds 64"):
        share("camera", 4, Peer(4, "reader"), others, EACH)
    with pytest.raises(NoSlots, match="no slots for one more client of pid 20"):
        share("camera", 4, NEW, [*others, (Peer(5, "reader"), 16)], EACH)


MIB = 1 << 20


def budget() -> MemoryBudget:
    return MemoryBudget("memory for masters", each=4 * MIB, most=8 * MIB)


def test_a_process_gets_so_much_memory_in_so_many_pieces() -> None:
    shared = budget()
    shared.took(1, GREEDY, 3 * MIB)
    shared.check(GREEDY, MIB)
    with pytest.raises(Busy, match=r"is 4 MiB for one process \(.*\); pid 10 \(greedy\) has 3145728 bytes"):
        shared.check(GREEDY, MIB + 1)
    shared.gone(1)
    for client in range(MEMORIES):
        shared.check(GREEDY, 1)
        shared.took(client, GREEDY, 1)
    with pytest.raises(Busy, match=r"pid 10 \(greedy\) has 64 pieces of memory for masters: no process gets more"):
        shared.check(GREEDY, 1)
    assert shared.held() == {GREEDY: MEMORIES}


def test_where_memory_is_used_up_the_four_that_have_most_are_named() -> None:
    shared = budget()
    for pid, size in ((1, 5), (2, 1), (3, 4), (4, 3), (5, 2)):
        shared.took(pid, Peer(pid, "reader"), size)
    shared.took(6, Peer(2, "reader"), 5)
    shared.took(7, GREEDY, 8 * MIB - 20)
    shared.check(NEW, 0)
    with pytest.raises(Busy) as refused:
        shared.check(NEW, 1)
    assert str(refused.value) == (
        "memory for masters is 8 MiB together; 8388608 bytes are taken (pid 10 (greedy) has 8388588, "
        "pid 2 (reader) has 6, pid 1 (reader) has 5, pid 3 (reader) has 4)"
    )
    shared.renew(4 * MIB, 9 * MIB)
    shared.check(NEW, MIB)


def test_memory_of_which_there_is_none_is_taken_by_nobody() -> None:
    with pytest.raises(Busy, match=r"0 bytes are taken \(by nobody\)"):
        MemoryBudget("memory", each=1, most=0).check(NEW, 1)
