# SPDX-License-Identifier: Apache-2.0
"""A stream's machine: its phases, who gets slots when, and who is refused; without sockets or devices."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from cm.device import DeviceError, DeviceTimeout
from cm.schema.model import Direction, Stream
from cm.server.client_process import Peer
from cm.server.streams.machine import (
    OPEN_PHASES,
    RESERVE,
    TRANSITIONS,
    IllegalTransition,
    NoSlots,
    Step,
    StepKind,
    StreamEvent,
    StreamMachine,
    StreamPhase,
    share,
)
from cm.wire.plane_packets import SLOTS_MAX

EACH = 64
GREEDY, NEW = Peer(10, "greedy", 10), Peer(20, "new", 20)
CAMERA = Stream("camera", "dma0", Direction.S2MM, slots=8)


def machine(**stream: Any) -> StreamMachine:
    made = StreamMachine("camera")
    made.open(Stream(**{"name": "camera", "channel": "dma0", "direction": Direction.S2MM, "slots": 8, **stream}))
    return made


def run(it: StreamMachine, most: int = SLOTS_MAX, steps: int = 1000) -> list[str]:
    """Take all steps, with memory for so many slots; who was attached, refused or started, in order."""
    log, made, given = [], it.made, it.given
    while (step := it.next()) is not None and steps > 0:
        steps -= 1
        if step.kind is StepKind.ALLOCATE and step.slots > most:
            made = max(made, most)
            log += [f"{m.client}: {m.error}" for m in it.failed(step, DeviceError(12, "no memory"), made)]
            continue
        made = max(made, step.slots) if step.kind is StepKind.ALLOCATE else made
        given = max(given, step.slots) if step.kind is StepKind.GIVE else given
        made = given if step.kind is StepKind.FREE else made
        it.took(step, made, given)
        if step.kind in (StepKind.ATTACH, StepKind.START):
            log.append(str(step.member.client) if step.member else "start")
    return log


# ---- phases ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("phase", "event"), list(product(StreamPhase, StreamEvent)))
def test_an_illegal_transition_raises_and_changes_nothing(phase: StreamPhase, event: StreamEvent) -> None:
    it = StreamMachine("camera")
    it.phase = phase
    if (phase, event) in TRANSITIONS:
        it.after(event)
        assert it.phase is TRANSITIONS[phase, event]
    else:
        with pytest.raises(IllegalTransition, match=f"^stream 'camera', which is {phase.value}, cannot {event.value}$"):
            it.after(event)
        assert it.phase is phase


def test_every_phase_can_be_entered_and_left() -> None:
    assert set(TRANSITIONS.values()) == {phase for phase, _ in TRANSITIONS} == set(StreamPhase)


def test_the_documentation_shows_the_table() -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "decisions" / "frames-as-descriptors.md"
    lines = ["stateDiagram-v2", "    [*] --> closed"]
    lines += [f"    {a.value} --> {b.value}: {event.value}" for (a, event), b in TRANSITIONS.items() if a is not b]
    assert "\n".join(lines) + "\n" in page.read_text(encoding="utf-8")


# ---- slots -----------------------------------------------------------------------------------------


def test_a_client_that_asks_for_all_gets_its_share_and_the_next_what_it_asks_for() -> None:
    assert share("camera", 255, GREEDY, [], EACH) == 64
    assert share("camera", 4, NEW, [(GREEDY, 64)], EACH) == 4


def test_the_same_user_gets_no_more_by_asking_again_from_whatever_process() -> None:
    assert share("camera", 60, GREEDY, [(GREEDY, 40)], EACH) == 24
    for peer in (GREEDY, Peer(11, "also greedy", GREEDY.uid)):
        with pytest.raises(NoSlots, match=r"pid 10 \(greedy\) holds 64, of 256; one user gets 64"):
            share("camera", 4, peer, [(GREEDY, 40), (GREEDY, 24)], EACH)


def test_the_last_slots_are_for_clients_without_any() -> None:
    others = [(Peer(pid, "reader", pid), 64) for pid in (1, 2, 3)] + [(Peer(4, "reader", 4), 42)]  # 234 of 250
    assert share("camera", 8, NEW, others, EACH) == 8
    with pytest.raises(NoSlots, match=r"pid 1 \(reader\) holds 64"):
        share("camera", 4, Peer(4, "reader", 4), others, EACH)
    with pytest.raises(NoSlots, match="no slots for one more client of pid 20"):
        share("camera", 4, NEW, [*others, (Peer(5, "reader", 5), 16)], EACH)


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
    it = machine(**stream)
    for client, (depth, wanted) in enumerate(zip(depths, slots, strict=True)):
        member = it.join(client, depth, Peer(client + 1, "reader", client + 1), EACH)
        assert run(it) == [str(client), *["start"] * (client == 0)]
        assert (it.made, it.given, member.depth) == (wanted, wanted, min(depth or 4, 64))
    assert list(it.joined) == list(range(len(depths)))


def test_a_stream_starts_once_all_that_wait_have_their_slots_but_waits_only_so_long() -> None:
    it = machine()
    for client, depth in ((1, 40), (2, 4), (3, 20)):
        it.join(client, depth, Peer(client, "reader", client))
    assert run(it) == ["2", "3", "1", "start"], "who needs fewer comes first"
    it = machine()
    for client in (1, 2):
        it.join(client, 4, Peer(client, "reader", client))
    assert run(it, steps=2) == ["1"]
    steps = 0
    while (step := it.next()) is not None and step.kind is not StepKind.START:
        steps += 1
        it.took(step._replace(kind=StepKind.ALLOCATE), it.made, it.given)  # it gets no further
    assert (steps, run(it)) == (SLOTS_MAX, ["start", "2"])


def test_slots_that_a_client_waits_for_count_as_held() -> None:
    it = machine()
    it.join(0, 64, GREEDY, EACH)
    with pytest.raises(NoSlots, match=r"pid 10 \(greedy\) holds 64, of 256"):
        it.join(1, 1, GREEDY, EACH)


def test_a_client_that_gets_no_slots_leaves_the_stream_as_it_was() -> None:
    it = machine()
    it.join(0, 4, GREEDY)
    it.join(1, 50, NEW)
    told = "no memory for a client of 50 frames more (no memory); close others, or ask for a smaller depth"
    assert run(it, most=40) == ["0", f"1: stream 'camera': {told}", "start"]
    assert (it.phase, it.made, it.given) == (StreamPhase.RUNNING, 8, 8)
    it.join(2, 50, NEW)
    assert run(it, most=40) == [f"2: stream 'camera': {told}"]
    assert (list(it.joined), it.made) == ([0], 8)
    gone = it.join(3, 30, NEW)
    assert run(it, steps=1) == []
    it.left(3)
    it.left(3)
    assert (it.made, run(it), it.made, gone.settled) == (36, [], 8, True)


def test_only_the_client_whose_slots_there_are_not_is_refused_by_a_stream_that_runs() -> None:
    it = machine()
    it.join(0, 4, GREEDY)
    run(it)
    for client, depth in ((1, 60), (2, 50)):
        it.join(client, depth, Peer(client, "reader", client))
    step = it.next()
    assert step is not None
    assert [member.client for member in it.failed(step, DeviceError(12, "no memory"), 8)] == [2]
    assert ([member.client for member in it.waiting], it.phase) == ([1], StreamPhase.RUNNING)


def test_a_stream_that_runs_and_cannot_give_its_hardware_slots_fails() -> None:
    it = machine()
    it.join(0, 4, GREEDY)
    run(it)
    assert it.failed(Step(StepKind.GIVE, 9), DeviceError(24, "no descriptors"), 8) == []
    assert (it.phase, list(it.members)) == (StreamPhase.RESTING, [0])


def test_a_stream_without_slots_for_the_hardware_refuses_all_that_wait() -> None:
    it, error = machine(), DeviceError(12, "no memory")
    members = [it.join(client, 4, Peer(client, "reader", client)) for client in (1, 2)]
    step = it.next()
    assert step is not None
    assert it.failed(step, error, 7) == members
    assert [(member.error, member.settled) for member in members] == [(error, True)] * 2
    assert (it.members, it.made) == ({}, 0)
    assert it.phase is StreamPhase.RESTING


def test_clients_on_this_machine_wait_while_their_stream_is_closed_unless_they_leave() -> None:
    it, ended = machine(), list[int]()
    it.join(1, 4, GREEDY)
    it.join(2, 2)  # the daemon's own
    run(it)
    it.join(3, 4, NEW)
    it.join(4, 60, NEW, stopped=ended.append)
    assert it.is_used
    for client in (3, 77):
        it.leaves(client)
    assert [member.client for member in it.waiting] == [4]
    it.after(StreamEvent.CLOSE)
    assert (list(it.members), it.joined, it.next(), ended) == ([1, 4], {}, None, [])
    assert all(member.settled for member in it.members.values())
    it.open(CAMERA)
    assert run(it) == ["1", "4", "start"]
    for client in (1, 4):
        it.leaves(client)
    assert not it.is_used


class Machines(RuleBasedStateMachine):
    """Whatever comes in whatever order, each client is answered once, and no more slots are given than there are."""

    def __init__(self) -> None:
        super().__init__()
        self.it = StreamMachine("camera")
        self.made = self.given = 0
        self.writes = False
        self.number = 0
        self.all: list[Any] = []

    @rule(event=st.sampled_from([e for e in StreamEvent if e is not StreamEvent.OPEN]))
    def happens(self, event: StreamEvent) -> None:
        if event is not StreamEvent.START and (self.it.phase, event) in TRANSITIONS:
            self.it.after(event)

    @precondition(lambda self: (self.it.phase, StreamEvent.OPEN) in TRANSITIONS)
    @rule(slots=st.integers(1, 300), direction=st.sampled_from(Direction), backpressure=st.booleans())
    def opens(self, slots: int, direction: Direction, backpressure: bool) -> None:
        self.made = self.given = 0
        self.writes = direction is Direction.MM2S
        self.it.open(Stream("camera", "dma0", direction, slots=slots, backpressure=backpressure))

    @rule(depth=st.integers(0, 300), user=st.integers(1, 4))
    def joins(self, depth: int, user: int) -> None:
        self.number += 1
        try:
            self.all.append(self.it.join(self.number, depth, Peer(user, "reader", user), EACH))
        except NoSlots:
            assert sum(m.depth for m in self.it.members.values() if m.peer.uid == user) >= EACH or (
                sum(m.depth for m in self.it.members.values()) > SLOTS_MAX - RESERVE - 4 - 16 - 1
            )

    @precondition(lambda self: self.it.members)
    @rule(data=st.data(), leaves=st.booleans())
    def goes(self, data: st.DataObject, leaves: bool) -> None:
        (self.it.leaves if leaves else self.it.left)(data.draw(st.sampled_from(sorted(self.it.members))))

    @rule(steps=st.integers(1, 40), fails=st.sampled_from([None, None, DeviceError(12, "no"), DeviceTimeout(110, "")]))
    def goes_on(self, steps: int, fails: DeviceError | None) -> None:
        for _ in range(steps):
            step = self.it.next()
            if step is None:
                return
            if step.kind is StepKind.ALLOCATE:
                assert self.made < step.slots <= SLOTS_MAX
                self.made = min(self.made + 8, step.slots)
            elif step.kind is StepKind.GIVE:
                assert self.given < step.slots <= self.made
                self.given = min(self.given + 8, step.slots)
            elif step.kind is StepKind.FREE:
                self.made = max(self.made - 8, self.given)
            elif step.kind is StepKind.ATTACH:
                assert step.member is not None
                given_first = self.it.phase is StreamPhase.RUNNING or self.writes
                assert (self.given if given_first else self.made) >= step.slots
                assert not step.member.settled or step.member in self.it.waiting
            self.it.took(step, self.made, self.given)
        step = self.it.next()
        if fails is not None and step is not None and step.kind is StepKind.ALLOCATE:
            for member in self.it.failed(step, fails, self.made):
                assert member.error is not None
                assert member.client not in self.it.members

    @invariant()
    def each_is_answered_once(self) -> None:
        held = set(self.it.members.values())
        for member in self.all:
            assert member in held or member.settled, "who is no member was answered"
            assert member.error is None or member not in held
        assert self.it.phase in OPEN_PHASES or not self.it.joined

    @invariant()
    def a_stream_that_is_left_alone_comes_to_rest(self) -> None:
        if self.it.phase in OPEN_PHASES and self.number % 4 == 3:
            self.goes_on(2000, None)
            assert self.it.next() is None
            assert not self.it.waiting
            assert self.it.phase is StreamPhase.RUNNING
            assert self.it.wanted() <= self.it.given == self.it.made


Machines.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
test_whatever_comes_in_whatever_order = Machines.TestCase
