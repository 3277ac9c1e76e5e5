# SPDX-License-Identifier: Apache-2.0
"""How the slots of a stream are shared out, and the memory for masters in the PL."""

from __future__ import annotations

import pytest

from cm.device import DeviceError
from cm.errors import Busy
from cm.schema.model import Direction, Stream
from cm.server.streams.client_memory import MEMORIES, MemoryBudget
from cm.server.streams.client_process import Peer
from cm.server.streams.slots import NoSlots, SlotHolders, share

EACH = 64

GREEDY, NEW = Peer(10, "greedy", 10), Peer(20, "new", 20)


def test_a_client_that_asks_for_all_gets_its_share_and_the_next_what_it_asks_for() -> None:
    assert share("camera", 255, GREEDY, [], EACH) == 64
    assert share("camera", 4, NEW, [(GREEDY, 64)], EACH) == 4


def test_the_same_user_gets_no_more_by_asking_again_from_whatever_process() -> None:
    assert share("camera", 60, GREEDY, [(GREEDY, 40)], EACH) == 24
    for peer in (GREEDY, Peer(11, "also greedy", GREEDY.uid)):
        with pytest.raises(NoSlots, match=r"pid 10 \(greedy\) holds 64, of 256; one user gets 64"):
            share("camera", 4, peer, [(GREEDY, 40), (GREEDY, 24)], EACH)


def test_the_last_slots_are_for_clients_without_any() -> None:
    others = [(Peer(pid, "reader", pid), 64) for pid in (1, 2, 3)] + [
        (Peer(4, "reader", 4), 42)
    ]  # 234 of the 250 there are
    assert share("camera", 8, NEW, others, EACH) == 8
    with pytest.raises(NoSlots, match=r"pid 1 \(reader\) holds 64"):
        share("camera", 4, Peer(4, "reader", 4), others, EACH)
    with pytest.raises(NoSlots, match="no slots for one more client of pid 20"):
        share("camera", 4, NEW, [*others, (Peer(5, "reader", 5), 16)], EACH)


class Made:
    """Slots that are made at once, and given to the plane as many as are asked for."""

    def __init__(self) -> None:
        self.made: list[int] = []
        self.given = 0
        self.most = 256

    def make_some(self, wanted: int) -> None:
        if wanted > self.most:
            raise DeviceError(12, "cannot allocate")
        self.made = [0] * max(wanted, len(self.made))

    def give_some(self, wanted: int) -> bool:
        self.given = max(self.given, wanted)
        return True

    def take_back_some(self) -> bool:
        self.made = self.made[: self.given]
        return True


def holders(each: int = EACH, **stream: object) -> tuple[SlotHolders, Made, list[tuple[int, int]]]:
    slots, attached = Made(), list[tuple[int, int]]()
    described: dict[str, object] = {
        "name": "camera",
        "channel": "dma0",
        "direction": Direction.S2MM,
        "slots": 8,
        **stream,
    }

    def attach(client: int, depth: int) -> bool:
        attached.append((client, depth))
        return client != GONE

    made = SlotHolders(Stream(**described), slots, attach, each)  # type: ignore[arg-type]
    return made, slots, attached


GONE = 99


@pytest.mark.parametrize(
    ("stream", "depths", "slots"),
    [
        ({}, [4], [8]), ({}, [6], [8]), ({}, [7, 3], [9, 12]), ({"slots": 300}, [4], [256]), ({}, [0], [8]),
        ({"backpressure": True}, [20, 20], [8, 8]), ({"direction": Direction.MM2S}, [4, 3], [4, 7]),
        ({"direction": Direction.MM2S, "backpressure": True}, [4, 9], [4, 13]), ({}, [400], [66]),
    ],
)  # fmt: skip
def test_a_stream_has_slots_for_all_clients_and_for_the_hardware(
    stream: dict[str, object], depths: list[int], slots: list[int]
) -> None:
    made, has, attached = holders(**stream)
    for client, (depth, wanted) in enumerate(zip(depths, slots, strict=True)):
        assert list(made.join(client, depth, Peer(client + 1, "reader", client + 1))) == []
        assert (len(has.made), has.given) == (wanted, wanted)
    assert attached == [(client, min(depth or 4, 64)) for client, depth in enumerate(depths)]
    assert list(made.peers) == list(range(len(depths)))
    assert made.started
    made.join(9, 1, Peer(9, "waits", 9))
    assert list(made.begin()) == []  # for nobody any more
    made.detached(9)
    made.detached(0)
    assert 0 not in made.peers


def test_a_client_that_gets_no_slots_leaves_the_stream_as_it_was() -> None:
    made, has, attached = holders()
    list(made.join(0, 4, Peer(1, "reader", 1)))
    has.most = 40
    told = r"client of 50 frames more \(cannot allocate\); close others, or ask for a smaller depth$"
    with pytest.raises(NoSlots, match=told):
        list(made.join(1, 50, Peer(2, "reader", 2)))
    has.most = 256
    list(made.join(GONE, 30, Peer(3, "reader", 3)))  # hangs up meanwhile
    assert (len(has.made), list(made.peers), len(attached)) == (36, [0], 2)  # what the plane has stays
    made, has, _ = holders()
    has.most = 7
    with pytest.raises(DeviceError, match="cannot allocate"):  # not even those of the hardware
        list(made.join(0, 4, Peer(1, "reader", 1)))
    made, _, _ = holders(each=256)
    for client, depth in enumerate((200, 40)):
        list(made.join(client, depth, Peer(client + 1, "reader", client + 1)))
    with pytest.raises(NoSlots, match="stream 'camera' has 2 clients; with one more it needs 257 slots"):
        list(made.join(3, 15))


def test_slots_that_a_client_waits_for_count_as_held() -> None:
    made, _, _ = holders()
    made.join(0, 64, GREEDY)
    with pytest.raises(NoSlots, match=r"pid 10 \(greedy\) holds 64, of 256"):
        made.join(1, 1, GREEDY)


def test_who_waits_for_the_start_of_a_stream_is_told_how_it_went() -> None:
    for error in (None, ValueError("no")):
        made, _, _ = holders()
        told: list[object] = []
        made.when_started(told.append)
        assert told == []
        if error is not None:
            made.fail(error)
        stopped: list[int] = []
        steps = made.join(0, 4, GREEDY, stopped.append)
        if error is None:
            assert list(made.begin()) == [None] * 256  # it waits for its reader, for so long
            list(steps)
        made.stop(5)
        made.stop(5)
        made.when_started(told.append)
        assert told == [error, None]
        assert (stopped, made.closed) == ([] if error is None else [5], True)


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
