# SPDX-License-Identifier: Apache-2.0
"""Whose message is answered next, and what happens to those of clients that ask too much or do not read."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import count
from types import SimpleNamespace
from typing import Any

import pytest

from cm.server import dispatcher
from cm.server.client_quotas import LITTLE, REPLY, TRACKED, Clients
from cm.server.dispatcher import Dispatcher
from cm.server.long_work import RoundRobin
from cm.server.rights.principal import from_id
from cm.server.sender_order import Asked
from cm.server.settings.model import USUAL
from cm.wire.encode import decode_reply, encode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ErrorInfo, Reply, Status
from cm.wire.multipart import Message

ONE, TWO, OTHER = "ipc:0:0:9000001", "ipc:0:0:9000002", "ipc:7:0:9000003"
STATUS = encode_request(rq.ReadStatus())
READ = encode_request(rq.ReadReg(("focus",)))


class Bench:
    """A dispatcher between sockets that are lists, over handlers that answer at once."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.coming: list[Message] = []
        self.sent: list[list[bytes]] = []
        self.unread: list[Any] = []  # trackers of replies
        self.asked: list[tuple[str, rq.Request]] = []
        self.soon: list[Any] = []
        self.noted: list[ErrorInfo] = []
        self.reply = Reply(Status("camera"))
        self.clients = Clients(USUAL, from_id)
        loop: Any = SimpleNamespace(call_soon=self.soon.append)
        gate: Any = SimpleNamespace(guest=lambda bridge, name: f"{name} through {bridge}")
        manager: Any = SimpleNamespace(registers=SimpleNamespace(visible_names=lambda: ()), memories=None)
        services: Any = SimpleNamespace(
            connections=SimpleNamespace(gate=gate), clients=self.clients, turns=RoundRobin(loop), manager=manager
        )
        publisher: Any = SimpleNamespace(sequence=7)
        monkeypatch.setattr(dispatcher, "receive_from", lambda _, routed: self.coming.pop(0))
        monkeypatch.setattr(dispatcher, "zmq_poll", lambda _, milliseconds: self.coming[:1])
        monkeypatch.setattr(dispatcher.multipart, "send", lambda _, frames: self.sent.append([*map(bytes, frames)]))
        monkeypatch.setattr(dispatcher.multipart, "send_tracked", self._send_tracked)
        monkeypatch.setattr(dispatcher, "carry_out", self._carry_out)
        sockets: Any = SimpleNamespace(req=None, sub=None)
        self.dispatcher = Dispatcher(loop, sockets, services, publisher, note_error=self.noted.append)

    def _carry_out(self, _: Any, asked: Asked) -> None:
        self.asked.append((asked.connection, asked.request))
        asked.answer(self.reply)

    def _send_tracked(self, _: Any, frames: list[bytes]) -> Any:
        self.sent.append([*map(bytes, frames)])
        self.unread.append(SimpleNamespace(done=False))
        return self.unread[-1]

    def comes(self, who: str, sender: bytes, *frames: bytes) -> None:
        self.coming.append(Message(who, [sender, b"", *frames]))

    def ask(self, *frames: bytes, who: str = ONE, sender: bytes = b"a") -> list[bytes]:
        """What is sent back for it at once."""
        self.sent.clear()
        self.comes(who, sender, *frames)
        self.dispatcher.on_request()
        return [frame for sent in self.sent for frame in sent]

    def code(self, **more: Any) -> str | None:
        """Of the answer to a request; None without one."""
        sent = self.ask(*STATUS, **more)
        error = decode_reply(sent[2:]).error if sent else None
        return (error.code if error else "") if sent else None

    def turn(self) -> None:
        calls = self.soon[:]
        self.soon.clear()
        for call in calls:
            call()


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


@pytest.mark.parametrize(
    "way",
    [
        [], [b""], [b"7", b""], [b"mine", b""], [b"cm_client_7", b""], [b"cm_", b""],
        [b"cm_status_of_mine", b"cm_x", b""], [b"\0\0", b"7", b""],
    ],
)  # fmt: skip
def test_an_answer_goes_back_the_way_that_its_request_came(bench: Bench, way: list[bytes]) -> None:
    for request in (STATUS, READ):
        bench.coming.append(Message(ONE, [b"a", *way, *request]))
        bench.dispatcher.on_request()
        assert bench.sent.pop() == [b"a", *way, *encode_reply(request[0], bench.reply, 7)]
    assert [who for who, _ in bench.asked] == [ONE] * 2
    assert bench.clients.of(ONE).requests == 2


@pytest.mark.parametrize(
    ("came", "back"),
    [
        ([b""], []), ([b"", b""], [b""]), ([b"cm_mine", b"x"], [b"cm_mine"]),
        ([b"", b"cm_status", b"", b"x"], [b"", b"cm_status"]),
    ],
)  # fmt: skip
def test_what_is_no_request_is_answered_too(bench: Bench, came: list[bytes], back: list[bytes]) -> None:
    bench.coming.append(Message(ONE, [b"a", *came]))
    bench.dispatcher.on_request()
    ((_, *sent),) = bench.sent
    assert sent[: len(back)] == back
    assert (decode_reply([b"", *sent[-1:]]).error.code, bench.asked) == ("invalid_request", [])  # type: ignore[union-attr]


def test_a_bridge_asks_for_its_guest(bench: Bench) -> None:
    bench.coming.append(Message(ONE, [b"a", b"for=ann", b"", *STATUS]))
    bench.dispatcher.on_request()
    assert [who for who, _ in bench.asked] == [f"ann through {ONE}"]


def test_a_client_with_many_connections_has_one_turn_and_another_the_next(bench: Bench) -> None:
    bench.ask(*STATUS)
    for number in range(40):
        bench.comes(ONE, b"%d" % (number % 5 + 1), *STATUS)
    bench.comes(TWO, b"b", *STATUS)
    served: list[bytes] = []
    bench.sent.clear()
    while bench.coming or bench.soon:
        before = len(bench.coming)
        bench.dispatcher.on_request()
        assert before - len(bench.coming) in (0, 33)  # while something waits it goes on by itself
        bench.turn()
        served += [sent[0] for sent in bench.sent]
        bench.sent.clear()
    assert len(served) == 41
    assert served.index(b"b") < 6
    client = bench.clients.of(ONE)
    assert (client.requests, client.waiting_bytes) == (41, 0)
    assert bench.code(who=TWO, sender=b"b") == ""


@pytest.mark.parametrize("others", [False, True])
def test_a_user_with_many_processes_has_one_turn_if_there_are_other_users(bench: Bench, others: bool) -> None:
    other = OTHER if others else TWO
    bench.ask(*STATUS, who=other, sender=b"b")
    for number in range(40):
        bench.comes(f"ipc:0:0:{9000010 + number}", b"%d" % number, *STATUS)
    bench.coming.insert(20, Message(other, [b"b", b"", *STATUS]))
    bench.sent.clear()
    while bench.coming or bench.soon:
        if bench.coming:
            bench.dispatcher.on_request()
        bench.turn()
    served = [sent[0] for sent in bench.sent]
    assert (len(served), served.index(b"b") < 10) == (41, others)


def test_of_a_client_that_asks_too_much_over_several_connections_each_request_is_answered(bench: Bench) -> None:
    bench.clients.limits = replace(USUAL, waiting_bytes=2 * (1024 + len(STATUS[0]) + 1))
    bench.ask(*STATUS)
    for number in range(4):
        bench.comes(ONE, b"%d" % number, *STATUS)
    bench.sent.clear()
    bench.dispatcher.on_request()
    for _ in range(4):
        bench.turn()
    told = {sent[0]: decode_reply(sent[2:]).error for sent in bench.sent}
    codes = {number: error.code if error else "" for number, error in told.items()}
    assert codes == {b"0": "", b"1": "", b"2": "too_much_waiting", b"3": "too_much_waiting"}
    assert bench.clients.of(ONE).refused == 2


def test_who_does_not_read_is_refused_then_not_even_told_and_served_again_once_it_has_read(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = count()  # the clock goes on between two requests
    monkeypatch.setattr(
        "cm.server.client_quotas.monotonic_ns", lambda: sum(c.requests for c in bench.clients) * 10**9 + next(looks)
    )
    bench.clients.limits = replace(USUAL, replies_bytes=100_000)
    client = bench.clients.of(ONE)
    bench.reply = Reply(Status("camera"), payload=(bytes(LITTLE),))
    told = []
    while (code := bench.code()) is not None and len(told) < 10:
        told.append(code)
        if code:
            client.make(40_000)
    assert Counter(told) == {"": 4, "replies_unread": 2}
    assert client.refused == 3
    client.make(-80_000)
    for tracker in bench.unread:
        tracker.done = True
    assert bench.code(who=TWO, sender=b"b") == ""
    assert bench.code() == ""


def test_short_answers_are_tracked_together(bench: Bench) -> None:
    size = sum(map(len, bench.ask(*STATUS))) + REPLY
    for _ in range(TRACKED // size - 1):
        bench.ask(*STATUS)
    assert (bench.unread, bench.clients.of(ONE).unread_bytes) == ([], 0)
    bench.ask(*STATUS)
    count = TRACKED // size + 1
    assert (len(bench.unread), bench.clients.of(ONE).unread_of) == (1, {b"a": count * size})


def test_so_many_long_writes_of_a_client_are_read_and_one_that_is_too_much_is_refused(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dispatcher, "PENDING", 2)
    write = encode_request(rq.WriteReg(tuple(rq.RegWrite(f"r{number}", number) for number in range(300))))
    assert [bench.ask(*write) for _ in range(2)] == [[], []]
    error = decode_reply(bench.ask(*write)[2:]).error
    assert error == ErrorInfo("too_much_waiting", "2 long requests of uid:0 wait: await a reply")
    assert bench.clients.of(ONE).refused == 1
    assert bench.ask(*write, who=OTHER, sender=b"b") == []


def test_a_message_without_a_reply_is_counted_and_its_error_noted(bench: Bench) -> None:
    for error in (None, ErrorInfo("busy", "not now")):
        bench.reply = Reply(error=error)
        bench.coming.append(Message(ONE, [b"cm_write_reg", b"{'focus': 2}"]))
        bench.dispatcher.on_message()
    bench.coming.append(Message(ONE, [b"cm_nonsense", b""]))
    bench.dispatcher.on_message()
    assert [error.code for error in bench.noted] == ["busy", "invalid_request"]
    assert (bench.clients.of(ONE).requests, bench.sent) == (3, [])
    assert bench.clients.of(ONE).refused == 1
