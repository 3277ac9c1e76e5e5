# SPDX-License-Identifier: Apache-2.0
"""How the memory for masters in the PL is shared out."""

from __future__ import annotations

import pytest

from cm.errors import Busy
from cm.server.streams.client_memory import MEMORIES, MemoryBudget
from cm.server.streams.client_process import Peer

GREEDY, NEW = Peer(10, "greedy", 10), Peer(20, "new", 20)


MIB = 1 << 20


def budget() -> MemoryBudget:
    return MemoryBudget("memory for masters", each=4 * MIB, most=8 * MIB)


def test_the_processes_of_a_user_get_so_much_memory_in_so_many_pieces() -> None:
    shared, again = budget(), Peer(11, "again", GREEDY.uid)
    shared.took(1, GREEDY, 3 * MIB)
    shared.check(GREEDY, MIB)
    with pytest.raises(Busy, match=r"is 4 MiB for one user \(.*\); processes of user 10 have 3145728 bytes"):
        shared.check(again, MIB + 1)
    shared.gone(1)
    for client in range(MEMORIES):
        shared.check(GREEDY, 1)
        shared.took(client, GREEDY, 1)
    with pytest.raises(Busy, match="processes of user 10 have 64 pieces of memory for masters: no user gets more"):
        shared.check(again, 1)
    shared.check(NEW, 1)
    assert shared.held() == {GREEDY: MEMORIES}


def test_where_memory_is_used_up_the_four_that_have_most_are_named() -> None:
    shared = budget()
    for pid, size in ((1, 5), (2, 1), (3, 4), (4, 3), (5, 2)):
        shared.took(pid, Peer(pid, "reader", pid), size)
    shared.took(6, Peer(2, "reader", 2), 5)
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
