# SPDX-License-Identifier: Apache-2.0
"""How the slots of a stream are shared out."""

from __future__ import annotations

import pytest

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
