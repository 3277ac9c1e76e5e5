# SPDX-License-Identifier: Apache-2.0
"""Registers that are read over the data socket: what is asked there, and when nothing is. The test is the manager."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from manager_process import short_folder

from cm.client import local_reads
from cm.client.connections import ByName
from cm.client.errors import BoardClosed
from cm.client.local_reads import LocalReads
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import DESCRIPTOR, NAME_MAX, Descriptor, Open, Purpose

HUNG = 60.0
READY = Descriptor(kind=packets.REGISTERS)


class Manager:
    """Answers each question, once it has let the client in."""

    def __init__(self, folder: Path, kept: ExitStack) -> None:
        self.folder, self._kept = folder, kept
        self._listener = kept.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        self._listener.settimeout(HUNG)
        self._listener.bind(str(folder / packets.SOCKET))
        self._listener.listen()

    def is_asked(self) -> bool:
        return bool(select.select([self._listener], [], [], 0)[0])

    def admits(self, answer: Descriptor = READY) -> socket.socket:
        """Let the next client in, or not."""
        peer = self._kept.enter_context(self._listener.accept()[0])
        peer.settimeout(HUNG)
        assert packets.decode_open(peer.recv(packets.PACKET_MAX)) == Open("", Purpose.REGISTERS)
        peer.send(answer.pack())
        return peer


@pytest.fixture
def manager() -> Iterator[Manager]:
    with short_folder() as folder, ExitStack() as kept:
        yield Manager(folder, kept)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    made = SimpleNamespace(now=100.0)
    monkeypatch.setattr(local_reads, "time", SimpleNamespace(monotonic=lambda: made.now))
    return made


def value(number: int, held: int, kind: int = packets.VALUE) -> bytes:
    return Descriptor(0, kind, 0, 0, held, number).pack()


def asked(peer: socket.socket) -> list[tuple[Descriptor, bytes]]:
    """The questions that wait."""
    found = []
    peer.setblocking(False)
    try:
        while True:
            packet = peer.recv(packets.PACKET_MAX)
            found.append((Descriptor(*DESCRIPTOR.unpack_from(packet)), packet[DESCRIPTOR.size :]))
    except BlockingIOError:
        return found


def question(number: int) -> Descriptor:
    return Descriptor(kind=packets.READ, sequence=number)


def opened(manager: Manager, waiting: list[int] | None = None, patience: float = HUNG) -> tuple[LocalReads, Any]:
    """Reads that could begin, and the manager's end of their connection."""
    reads = LocalReads(manager.folder, waiting if waiting is not None else [], patience)
    assert reads.read("led") is None  # never waits for a connection
    return reads, manager.admits()


def test_a_name_has_a_number_that_none_had_and_keeps_it(manager: Manager) -> None:
    reads, peer = opened(manager)
    for number, held in ((1, 7), (1, 8), (2, (1 << 64) - 1)):
        peer.send(value(number, held))
        assert reads.read("led" if number == 1 else "a" * NAME_MAX) == held
    assert asked(peer) == [(question(1), b"led"), (question(1), b"led"), (question(2), b"a" * NAME_MAX)]
    for none in ("a" * (NAME_MAX + 1), "\udc80", None, 3):
        assert reads.read(none) is None  # type: ignore[arg-type]
    assert asked(peer) == []


def test_nothing_is_asked_while_a_request_of_this_client_may_still_take_effect(manager: Manager) -> None:
    waiting = [1]
    reads, peer = opened(manager, waiting)
    assert (reads.read("led"), asked(peer)) == (None, [])
    waiting.clear()
    peer.send(value(1, 7))
    assert reads.read("led") == 7


def test_a_name_that_leads_elsewhere_is_asked_for_more_seldom_each_time(manager: Manager) -> None:
    reads, peer = opened(manager)
    tried: list[int] = []
    for turn in range(330):
        if tried[-1:] in ([], [turn - 1]):  # the answer to the next one
            peer.send(value(len(tried) + 1, 0, packets.ELSEWHERE))
        assert reads.read("led") is None
        tried += [turn for _ in asked(peer)]
    assert tried == [0, 2, 6, 14, 30, 62, 126, 190, 254, 318]


@pytest.mark.parametrize("known", [True, False], ids=["64 bits", "32 bits"])
def test_an_answer_that_comes_too_late_is_to_no_other_question(
    manager: Manager, clock: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, known: bool
) -> None:
    monkeypatch.setattr(local_reads, "LIMITS_ARE_KNOWN", known)
    reads, peer = opened(manager, patience=0.05)
    assert (reads.read("led"), len(asked(peer))) == (None, 1)
    assert (reads.read("led"), asked(peer)) == (None, []), "not at once"
    clock.now += 0.02
    for late in (value(1, 1), value(2, 7)):
        peer.send(late)
    assert reads.read("led") == 7
    assert asked(peer) == [(question(2), b"led")]


@pytest.mark.parametrize("how", ["refuses", "hangs up"])
def test_where_there_are_no_such_reads_they_are_tried_more_seldom(
    manager: Manager, clock: SimpleNamespace, how: str
) -> None:
    reads = LocalReads(manager.folder, [], HUNG)

    def tries() -> bool:
        assert reads.read("led") is None
        if not manager.is_asked():
            return False
        peer = manager.admits(Descriptor(kind=packets.REFUSED))
        if how == "hangs up":
            peer.close()
        assert reads.read("led") is None
        return True

    assert tries()
    for pause in (min(0.01 * 2**n, 30.0) for n in range(14)):
        clock.now += 0.95 * pause
        assert not tries()
        clock.now += 0.1 * pause
        assert tries()
    clock.now += 400.0  # a manager was there for long
    assert tries()
    clock.now += 0.011
    assert tries()


def test_reads_end_with_their_board_and_are_not_a_childs(manager: Manager, clock: SimpleNamespace) -> None:
    for end in (lambda reads: reads.end(BoardClosed("over")), LocalReads.disown):
        reads, peer = opened(manager)
        peer.send(value(1, 7))
        assert reads.read("led") == 7
        end(reads)
        clock.now += 100.0
        assert (reads.read("led"), manager.is_asked()) == (None, False)
        assert peer.recv(packets.PACKET_MAX) == question(1).pack() + b"led"
        assert peer.recv(packets.PACKET_MAX) == b""


@pytest.mark.parametrize("there", [True, False])
def test_the_first_eight_reads_of_a_board_are_requests(there: bool, manager: Manager) -> None:
    sockets: Any = SimpleNamespace(using=lambda user: user)
    reads = ByName(sockets, manager.folder if there else None, [], HUNG)
    first = reads.read
    assert [reads.read("led") for _ in range(8)] == [None] * 8
    assert reads.read == first
    assert reads.read("led") is None
    assert (reads.read == first) == (not there)
    if there:
        assert reads.read("led") is None
        manager.admits().send(value(1, 7))
        assert reads.read("led") == 7
