# SPDX-License-Identifier: Apache-2.0
"""Requests of one sender take effect in their order, those of different senders beside each other."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from manager_process import CAMERA

from cm.errors import NotFound
from cm.schema import load_folder
from cm.server.client_quotas import Clients
from cm.server.requests import BY_KIND
from cm.server.rights.principal import from_id
from cm.server.sender_order import Asked, Holds, Order
from cm.server.settings.model import USUAL
from cm.wire.encode import encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ErrorInfo, Reply
from cm.wire.parse import writes
from cm.wire.request_table import BY_KIND as ON_THE_WIRE

LONG = tuple(rq.RegWrite("focus", 1) for _ in range(33))
LED, THRESHOLD = (rq.WriteReg((rq.RegWrite(name, 1),)) for name in ("led.pattern", "threshold.low"))
READ, CHANGE = rq.ReadReg(("focus",)), rq.ChangeMode("camera", "default")
RAM, OTHER_RAM = rq.WriteData("scratchpad", b"1234"), rq.WriteData("nothing", b"1")
LOOKS = (rq.ReadStatus(), rq.ReadConfig(), rq.ListConfigs(), rq.PlanChange(), rq.ReadIrq(), rq.CancelChange())
STORE, REMOVE = rq.Provision("config: {}"), rq.RemoveConfig("x")
HELD = {STORE: Holds.STORES, REMOVE: Holds.STORES, RAM: Holds.WRITES}


class Bench:
    """An order over handlers that do nothing until a test ends what they began."""

    def __init__(self, mode: str = "edge_detection") -> None:
        camera = load_folder(CAMERA)["camera"]
        memory = camera.visible_memories(mode)["scratchpad"]

        def find(name: str) -> Any:
            if name == "wrong":
                raise NotFound("it is of another mode")
            return memory if name == "scratchpad" else None

        manager: Any = SimpleNamespace(
            loaded_config=lambda: camera, state=SimpleNamespace(mode=mode), memories=SimpleNamespace(find=find),
        )  # fmt: skip
        self.began: list[rq.Request] = []
        self.asked: list[Asked] = []
        self.replies: list[Reply] = []
        self.manager, self.order = manager, Order(manager, self.carry_out)

    def carry_out(self, asked: Asked) -> None:
        self.asked.append(asked)
        self.began.append(asked.request)
        many = len(getattr(asked.request, "writes", ())) > 32
        if held := Holds.LONG if many else HELD.get(asked.request):
            asked.hold(held)  # as its handler does

    def asks(self, request: Any, sender: bytes = b"a") -> Asked:
        """A request on its way."""
        row, client = BY_KIND[type(request)], Clients(USUAL, from_id).of("ipc:0:0:9000001")
        return Asked(row, request, "of the sender", sender, client, client, self.order, self.replies.append)

    def take(self, *requests: rq.Request, sender: bytes = b"a") -> int:
        """Take these; returns how many of them began at once."""
        before = len(self.began)
        for request in requests:
            self.order.take(self.asks(request, sender))
        return len(self.began) - before

    def change(self, *scopes: str) -> Callable[[], None]:
        """Begin a change; the result ends it."""
        assert self.take(CHANGE) == 1
        change: Any = SimpleNamespace(scopes=scopes)
        self.order.began(b"a", change)
        return lambda: self.order.ended(b"a", change)


def test_a_write_waits_for_a_change_of_what_it_touches_and_all_that_follows_for_the_write() -> None:
    it = Bench()
    end = it.change("region:prr0")
    assert it.take(LED, READ, OTHER_RAM, rq.DefineMemory("x"), CHANGE) == 5  # not of that region
    assert it.take(THRESHOLD, LED, READ) == 0
    assert it.take(*LOOKS) == len(LOOKS)
    assert it.take(THRESHOLD, sender=b"b") == 1  # another's
    began = len(it.began)
    end()
    assert it.began[began:] == [THRESHOLD, LED, READ]
    assert it.order.senders == {}


@pytest.mark.parametrize(
    ("scopes", "request_", "waits"),
    [
        (("config",), LED, True), (("config",), RAM, True), (("config",), rq.DefineMemory("x"), True),
        (("config",), rq.ConfigureStream("camera"), True), (("config",), READ, False), (("config",), CHANGE, False),
        (("config",), rq.ReadData("camera"), False), (("config",), rq.TakeLease("board"), False),
        (("registers:threshold",), THRESHOLD, True), (("registers:threshold",), LED, False),
        (("region:None",), RAM, True), (("region:None",), LED, True), (("memories:scratchpad",), RAM, True),
        (("memories:scratchpad",), rq.ConfigureStream("scratchpad"), True), (("memories:x",), RAM, False),
        (("region:prr0",), rq.ConfigureStream("camera"), True), (("region:prr0",), rq.ReadReg(("threshold",)), False),
        (("region:prr0",), rq.WriteData("camera"), True), (("region:prr1",), rq.ConfigureStream("camera"), False),
        (("region:None",), rq.WriteData("wrong"), True), ((), LED, False),
    ],
)  # fmt: skip
def test_what_waits_for_a_change(scopes: tuple[str, ...], request_: rq.Request, waits: bool) -> None:
    it = Bench()
    end = it.change(*scopes)
    assert it.take(request_) == (not waits)
    end()
    assert it.began[-1] == request_


@pytest.mark.parametrize(
    ("first", "follows", "waits"),
    [
        (STORE, CHANGE, True), (REMOVE, CHANGE, True), (STORE, REMOVE, True), (STORE, LED, False),
        (STORE, READ, False),
        (RAM, CHANGE, True), (RAM, STORE, True), (RAM, RAM, True), (RAM, LED, True), (RAM, READ, False),
        (RAM, OTHER_RAM, False), (LED, CHANGE, False), (READ, CHANGE, False),
        (rq.WriteReg(LONG), READ, True), (rq.WriteReg(LONG), CHANGE, True), (rq.WriteReg(LONG), LED, True),
        (rq.WriteReg(LONG), rq.TakeLease("board"), True), (rq.WriteReg(LONG), rq.ReadStatus(), False),
    ],
)  # fmt: skip
def test_what_waits_for_something_that_takes_long(first: rq.Request, follows: rq.Request, waits: bool) -> None:
    it = Bench()
    assert it.take(first) == 1
    assert it.take(follows) == (not waits)
    reply = Reply(error=ErrorInfo("busy", "not now"))
    for _ in range(2):  # the second is none
        it.asked[0].answer(reply)
    assert it.replies == [reply]
    assert it.began == [first, follows]
    it.asked[1].answer(reply)
    assert it.order.senders == {}


def test_an_answer_that_cannot_be_encoded_is_one_all_the_same() -> None:
    it, sent = Bench(), list[Reply]()

    def reply(made: Reply) -> None:
        if made.error is None:
            raise ValueError("no such field")
        sent.append(made)

    asked = it.asks(READ)
    asked._reply = reply
    asked.answer(Reply())
    assert [made.error for made in sent] == [ErrorInfo("internal", "ValueError: no such field")]


def test_so_many_requests_of_a_sender_wait() -> None:
    it = Bench()
    end = it.change("config")
    assert it.take(*[LED] * 257) == 0
    (refused,) = it.replies
    assert refused.error == ErrorInfo("busy", "256 requests wait for the end of a change; ask again after it")
    assert it.take(LED, sender=b"b") == 1
    end()
    assert it.began[2:] == [LED] * 256


@pytest.mark.parametrize("good", [True, False])
def test_what_follows_a_request_that_is_still_being_read_waits_behind_it(good: bool) -> None:
    it = Bench()
    request = rq.WriteReg(tuple(rq.RegWrite(f"r{number}" * (number < 199 or good or 99), 1) for number in range(200)))
    still, message = it.asks(request), bytes(encode_request(request)[1])
    still.request = None
    steps = it.order.take_in_slices(still, writes(message))
    next(steps)
    assert it.take(LED, rq.ReadStatus()) == 1
    assert it.take(LED, sender=b"b") == 1
    list(steps)
    if good:
        assert it.began[2:] == [request]  # behind it, as it is long
        it.asked[2].answer(Reply())
    assert it.began[3 if good else 2 :] == [LED]
    assert [reply.error is None for reply in it.replies] == [good]
    assert it.order.senders == {}


def test_a_request_is_a_row_of_both_tables() -> None:
    assert set(BY_KIND) == set(ON_THE_WIRE) == set(get_args(rq.Request))


@pytest.mark.parametrize(
    ("request_", "scopes"),
    [
        (LED, {"registers:led", "region:None"}), (THRESHOLD, {"registers:threshold", "region:prr0"}),
        (rq.WriteReg((rq.RegWrite("unknown", 1),)), {"registers:unknown", "region:None"}),
        (RAM, {"memories:scratchpad", "region:None"}), (rq.WriteData("camera"), {"memories:camera", "region:prr0"}),
        (rq.ConfigureStream("unknown"), {"memories:unknown", "region:None"}), (READ, set()),
    ],
)  # fmt: skip
def test_what_a_request_writes_is_told_in_scopes(request_: rq.Request, scopes: set[str]) -> None:
    it = Bench()
    assert set(BY_KIND[type(request_)].writes(request_, it.manager)) == scopes
    it.manager.loaded_config = lambda: None
    it.manager.memories.find = lambda _: None
    unnamed = {scope if scope[:6] != "region" else "region:None" for scope in scopes}
    assert set(BY_KIND[type(request_)].writes(request_, it.manager)) == unnamed
