# SPDX-License-Identifier: Apache-2.0
"""How the memory for masters in the PL is shared out."""

from __future__ import annotations

import pytest

from cm.errors import Busy
from cm.server.client_process import Peer
from cm.server.streams.client_memory import MEMORIES, check_share

GREEDY, AGAIN, NEW = Peer(10, "greedy", 10), Peer(11, "again", 10), Peer(20, "new", 20)
MIB = 1 << 20
LIMITS = 4 * MIB, 8 * MIB


def test_the_processes_of_a_user_get_so_much_memory_in_so_many_pieces() -> None:
    check_share(GREEDY, MIB, [(GREEDY, 3 * MIB)], *LIMITS)
    with pytest.raises(Busy, match=r"is 4 MiB for one user \(.*\); processes of user 10 have 3145728 bytes"):
        check_share(AGAIN, MIB + 1, [(GREEDY, 3 * MIB)], *LIMITS)
    many = [(GREEDY, 1)] * MEMORIES
    check_share(AGAIN, 1, many[1:], *LIMITS)
    with pytest.raises(Busy, match="processes of user 10 have 64 pieces of memory: no user gets more"):
        check_share(AGAIN, 1, many, *LIMITS)
    check_share(NEW, 1, many, *LIMITS)


def test_where_memory_is_used_up_the_four_that_have_most_are_named() -> None:
    held = [(Peer(pid, "reader", pid), size) for pid, size in ((1, 5), (2, 1), (3, 4), (4, 3), (5, 2))]
    held += [(Peer(2, "reader", 2), 5), (GREEDY, 8 * MIB - 20)]
    check_share(NEW, 0, held, *LIMITS)
    with pytest.raises(Busy) as refused:
        check_share(NEW, 1, held, *LIMITS)
    assert str(refused.value) == (
        "memory for masters in the PL and echoes is 8 MiB together; 8388608 bytes are taken (pid 10 (greedy) has "
        "8388588, pid 2 (reader) has 6, pid 1 (reader) has 5, pid 3 (reader) has 4)"
    )
    check_share(NEW, MIB, held, 4 * MIB, 9 * MIB)


def test_memory_of_which_there_is_none_is_taken_by_nobody() -> None:
    with pytest.raises(Busy, match=r"0 bytes are taken \(by nobody\)"):
        check_share(NEW, 1, [], 1, 0)
