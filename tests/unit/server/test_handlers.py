# SPDX-License-Identifier: Apache-2.0
"""What handlers do with what they are given back, whatever that is: each request is answered once, and counted."""

from __future__ import annotations

import errno
import time
from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest

from cm.device import DeviceGone
from cm.errors import Forbidden
from cm.manager.errors import ChangeBusy
from cm.schema import loads
from cm.server import request_handlers as handlers
from cm.server.client_quotas import Clients
from cm.server.long_work import NOT_YET
from cm.server.provision import Owned, Sender
from cm.server.request_handlers import CHANGES_EACH, Services, carry_out, list_configs, name_check, sender_of
from cm.server.requests import BY_KIND
from cm.server.rights.admission import Gate
from cm.server.rights.model import Access, Grant, Role
from cm.server.rights.policy import Users
from cm.server.rights.principal import from_id
from cm.server.sender_order import Asked, Holds
from cm.server.settings.model import USUAL
from cm.wire.encode import decode_reply, encode_reply
from cm.wire.messages import requests as rq
from cm.wire.messages.status import (
    ChangeInfo,
    ClientStatus,
    ConfigInfo,
    ErrorInfo,
    FrameInfo,
    LeaseStatus,
    MemoryInfo,
    RegionCheck,
    RegValue,
    RegValues,
    Reply,
    Status,
    StreamClient,
    StreamStatus,
)

GONE = DeviceGone(errno.ENODEV, "/dev/uio0: the board is gone")
ME = "ipc:0:0:9000001"
NAME = "pid 9000001"
WHO = "user (uid 0, pid 9000001)"


class Bench:
    """Handlers over a manager whose every call goes as the test says: it returns `made`, or raises `error`."""

    def __init__(self) -> None:
        self.error: Exception | None = None
        self.made: Any = None
        self.noticed: list[Exception] = []
        self.replies: list[Reply] = []
        self.ends: list[Any] = []  # callbacks of changes and checks
        self.given: list[tuple[Any, ...]] = []  # what the manager and its streams were asked for
        self.ended: list[str] = []
        self.transfer = SimpleNamespace(
            memory=SimpleNamespace(name="ram"),
            form=((2,), "uint32"),
            length=8,
            offset=4,
            write=False,
            data=b"12345678",
            step=self._step,
        )
        self.memory: Any = None
        self.clients = Clients(USUAL, from_id)
        self.client = self.clients.of(ME)
        memories = SimpleNamespace(
            find=lambda _: self.memory, check_no_memory=lambda _: None, defined=lambda: (), listed=lambda: "",
            begin_read=self._of("begin", self._begin), begin_write=self._of("begin", self._begin),
            info=lambda memory: memory, define=self._of("define", self._go),
        )  # fmt: skip
        stream = SimpleNamespace(name="camera", format="yuyv", region=None)
        streams = SimpleNamespace(
            named=lambda *_: stream, allocated=lambda: Counter({NAME: 5}), status_of=self._go,
            check_lease=lambda of, lease: self.given.append((of.name, lease)),
            configure=self._of("configure", self._ends), read_once=self._of("read", self._ends),
            write=self._of("write", self._ends),
        )  # fmt: skip
        manager = SimpleNamespace(
            memories=memories, mapped=(), reporter=SimpleNamespace(was_read=lambda: None), loaded_config=lambda: None,
            registers=SimpleNamespace(read=self._of("read", self._go), visible_names=lambda: ()),
            state=SimpleNamespace(config="camera", mode="on"), submit=self._of("submit", self._submit),
            repair=self._of("repair", self._submit), plan=self._of("plan", self._go), cancel=self._go,
            write_registers=self._of("write", self._go), region_map=self._of("map", self._go),
            prepared_check=self._of("prepare", self._go), check=self._of("check", self._check),
        )  # fmt: skip
        status = Status(
            leases=(LeaseStatus(1, "board", client=NAME),),
            streams=(StreamStatus("camera", "dma0", "s2mm", clients=(StreamClient(9, "view", depth=3),)),),
        )
        self.services: Any = Services(
            manager=manager, streams=streams, board=SimpleNamespace(notice_error=self.noticed.append),
            turns=SimpleNamespace(start=self._start), clients=self.clients,
            connections=SimpleNamespace(
                gate=SimpleNamespace(admit=lambda _, request, *__: request), scene=None, counted=lambda: {NAME: 2}
            ),
            uploads=SimpleNamespace(fill_in=lambda _: None), status=lambda: status, leases=None,
            files=SimpleNamespace(submit=self._submit_work), provisioner=None,
            interrupts=SimpleNamespace(counts={"done": 3}), complete=None, renew_config=self.given.append,
            loop=SimpleNamespace(call_threadsafe=lambda call: call()),
            audits=SimpleNamespace(publisher=SimpleNamespace(wants_audit=False)),
        )  # type: ignore[arg-type]  # fmt: skip
        self.held: list[Holds] = []
        self.started: list[Any] = []  # clients whose work was taken in steps, or beside the loop
        self.order = SimpleNamespace(
            began=lambda *_: None,
            hold=lambda _, what: self.held.append(what),
            release=lambda *_: None,
            ended=lambda _, change: self.ended.append(f"change {change.reply().body.number}"),
        )

    def _start(self, client: Any, steps: Any) -> None:
        self.started.append(client)
        self.steps = list(steps)

    def _submit_work(self, client: Any, work: Any, finish: Any) -> None:
        self.started.append(client)
        finish(work)

    def _go(self, *_: Any) -> Any:
        if self.error is not None:
            raise self.error
        return self.made

    def _step(self) -> bool:
        self._go()
        return True

    def _of(self, what: str, call: Any) -> Any:
        """A call that is noted with what it was given, but for callbacks."""

        def noted(*given: Any, **named: Any) -> Any:
            self.given.append((what, *[one for one in (*given, *named.values()) if not callable(one)]))
            return call(*given)

        return noted

    def _ends(self, *given: Any) -> None:
        (done,) = filter(callable, given)
        done(self.error or self.made)

    def _begin(self, *_: Any) -> Any:
        return self.transfer

    def _submit(self, _: Any, on_done: Any) -> Any:
        self._go()
        self.ends.append(on_done)
        return SimpleNamespace(number=4, reply=lambda: Reply(ChangeInfo(4, done=True)))

    def _check(self, _: Any, on_done: Any) -> None:
        self.ends.append(on_done)

    def ask(self, request: rq.Request) -> None:
        order: Any = self.order
        row = BY_KIND[type(request)]
        asked = Asked(row, request, ME, b"a", self.client, self.client, order, self.replies.append)
        carry_out(self.services, asked)

    def codes(self) -> list[str]:
        return [reply.error.code if reply.error else "" for reply in self.replies]


@pytest.fixture
def bench() -> Bench:
    return Bench()


OF_MEMORY = [rq.ReadData("ram", offset=4, length=8), rq.WriteData("ram", b"1", offset=4)]


@pytest.mark.parametrize(
    "request_",
    [
        rq.ReadReg(("focus",)), rq.WriteReg((rq.RegWrite("focus", 1),)), rq.PlanChange("camera"), rq.MapRegion("prr0"),
        rq.ChangeMode("camera"), rq.CheckRegion("prr0"), rq.CheckRegion("prr0", repair=True), rq.CancelChange(),
        rq.DescribeData("camera"), rq.DefineMemory("ram"), rq.ConfigureStream("camera"), rq.ReadData("camera"),
        rq.WriteData("camera", b"1"), *OF_MEMORY,
    ],
    ids=lambda request: type(request).__name__,
)  # fmt: skip
def test_a_board_that_has_gone_is_noticed_whatever_finds_out(bench: Bench, request_: rq.Request) -> None:
    bench.error = GONE
    bench.ask(request_)
    assert bench.noticed == [GONE]
    assert [reply.error and (reply.error.code, reply.error.message) for reply in bench.replies] == [
        ("device_gone", "/dev/uio0: the board is gone")
    ]
    assert bench.client.changes == 0


LED = (rq.RegWrite("led", 1),)
REPAIR = rq.CheckRegion("r", repair=True, lease="mine")


@pytest.mark.parametrize(
    ("request_", "given"),
    [
        (rq.ReadReg(("led",)), [("read", ("led",))]), (rq.WriteReg(LED, "mine"), [("write", LED, "mine", WHO)]),
        (rq.PlanChange("camera", "on"), [("plan", rq.ChangeMode("camera", "on"))]), (rq.MapRegion("r"), [("map", "r")]),
        (rq.ChangeMode("camera"), [("submit", rq.ChangeMode("camera"), WHO)]),
        (rq.CheckRegion("r"), [("prepare", "r"), ("check", "made")]),
        (REPAIR, [("repair", REPAIR, WHO)]),
        (rq.DescribeData("camera", "mine"), [("camera", "mine")]),
        (rq.DefineMemory("ram", 8, length=4), [("define", rq.DefineMemory("ram", 8, length=4))]),
        (
            rq.ConfigureStream("camera", slots=3, lease="mine"),
            [("camera", "mine"), ("configure", rq.ConfigureStream("camera", slots=3, lease="mine"))],
        ),
        (rq.ReadData("camera", 2.5), [("read", "camera", 2.5)]),
        (rq.WriteData("camera", b"1", lease="mine"), [("write", "camera", b"1", "mine")]),
        (rq.ReadData("ram", offset=4, length=8), [("begin", "ram", 4, 8)]),
        (rq.WriteData("ram", b"1", offset=4, lease="mine"), [("begin", "ram", 4, b"1", "mine")]),
    ],
    ids=lambda given: type(given).__name__,
)  # fmt: skip
def test_what_a_request_says_is_what_is_asked_for(
    bench: Bench, request_: rq.Request, given: list[tuple[Any, ...]]
) -> None:
    bench.made = "made"
    bench.ask(request_)
    assert bench.given == given


def test_a_defect_is_logged_and_answered(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    for bench.error, code, message in (
        (ValueError("a defect"), "internal", "ValueError: a defect"),
        (OSError(5, "it broke"), "device_error", "[Errno 5] it broke"),
    ):  # fmt: skip
        bench.ask(rq.ReadReg(("focus",)))
        assert bench.replies[-1].error == ErrorInfo(code, message)
    (record,) = caplog.records
    assert (record.getMessage(), record.levelname) == ("a request failed", "ERROR")
    assert record.exc_info is not None
    assert record.exc_info[0] is ValueError


def test_a_client_may_have_so_many_changes_and_checks_and_more_as_they_end(bench: Bench) -> None:
    asked = [rq.ChangeMode("camera"), rq.CheckRegion("prr0"), rq.CheckRegion("prr0", repair=True)] * 9
    for request in asked[:CHANGES_EACH]:
        bench.ask(request)
    assert (bench.client.changes, bench.replies) == (CHANGES_EACH, [])
    for request in asked[:3]:
        bench.ask(request)
    said = [reply.error.message if reply.error else "" for reply in bench.replies]
    assert said == [f"{CHANGES_EACH} changes and checks of uid:0 wait or run; try again when one has ended"] * 3
    found = RegionCheck("prr0", "edge", "good")
    for number, (request, end) in enumerate(zip(asked, bench.ends, strict=False)):
        checks = request == asked[1]
        end(found if checks else SimpleNamespace(reply=lambda: Reply(ChangeInfo(4, done=True))))
        assert bench.replies[-1].body == (found if checks else ChangeInfo(4, done=True))
        assert bench.client.changes == CHANGES_EACH - number - 1
    assert bench.ended == ["change 4"] * sum(
        not (isinstance(r, rq.CheckRegion) and not r.repair) for r in asked[:CHANGES_EACH]
    )
    assert len(bench.replies) == 3 + CHANGES_EACH


def test_a_check_that_fails_is_answered_and_no_longer_counts(bench: Bench) -> None:
    bench.ask(rq.CheckRegion("prr0"))
    bench.ends[0](GONE)
    assert (bench.codes(), bench.noticed, bench.client.changes) == (["device_gone"], [GONE], 0)


@pytest.mark.parametrize("write", [False, True])
@pytest.mark.parametrize("error", [None, GONE], ids=["whole", "in part"])
def test_many_registers_are_done_in_pieces_and_what_was_written_is_told(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, write: bool, error: Exception | None
) -> None:
    values = RegValues((RegValue("focus", 1), RegValue("focus", 2)), "camera", "on", 7)
    given: list[Any] = []

    class Pieces:
        def __init__(self, *made: Any) -> None:
            given.extend(made)
            self.at = 0

        @property
        def newest(self) -> Any:
            return values.values[self.at - 1 : self.at]

        @property
        def result(self) -> RegValues:
            return values._replace(values=values.values[: self.at])

        def step(self) -> bool:
            if self.at and error is not None:
                raise error
            self.at += 1
            return self.at == 2

    for kind in ("ReadPieces", "WritePieces"):
        monkeypatch.setattr(handlers, kind, Pieces)
    told: list[Any] = []
    manager = bench.services.manager
    whose: list[str] = []
    manager.tell_registers = lambda values, by: told.append(values) or whose.append(by)
    writes = (rq.RegWrite("focus", 1),) * 33
    bench.ask(rq.WriteReg(writes, "lease") if write else rq.ReadReg(("focus",) * 33))
    assert bench.held == [Holds.LONG]
    assert given == ([manager.registers, writes, "lease"] if write else [manager.registers, ("focus",) * 33])
    assert (bench.started, len(bench.steps)) == ([bench.client], 1)
    (reply,) = bench.replies
    assert (reply.error is None, bench.noticed) == (error is None, [error] if error else [])
    done = values if error is None else values._replace(values=values.values[:1])
    for said in (*told, reply.body) if error is None else told:
        assert decode_reply(encode_reply(b"cm_read_reg", Reply(said), 1)).body == done
    assert len(told) == write
    assert whose == [WHO] * write


def test_a_change_that_is_not_waited_for_is_answered_once(bench: Bench) -> None:
    bench.ask(rq.ChangeMode("camera", no_wait=True))
    assert [reply.body for reply in bench.replies] == [ChangeInfo(4, done=False)]
    bench.ends[0](SimpleNamespace(reply=lambda: Reply(ChangeInfo(4, done=True))))
    assert (len(bench.replies), bench.ended, bench.client.changes) == (1, ["change 4"], 0)


def test_a_memorys_payload_says_where_it_was_and_when(bench: Bench) -> None:
    before = time.monotonic_ns()
    for request in OF_MEMORY:
        bench.transfer.write = isinstance(request, rq.WriteData)
        bench.ask(request)
    for reply in bench.replies:
        assert isinstance(reply.body, FrameInfo)
        assert before <= reply.body.timestamp_ns <= time.monotonic_ns()
        told = FrameInfo("ram", 0, reply.body.timestamp_ns, 8, (2,), "uint32", "camera", "on", offset=4)
        assert reply.body == told
    assert [reply.payload for reply in bench.replies] == [(b"12345678",), ()]


def test_a_picture_in_another_order_of_pixels_is_refused(bench: Bench) -> None:
    for form in ("rgb", "yuyv", ""):
        bench.made = FrameInfo("camera", 0, 0, 1)
        bench.ask(rq.WriteData("camera", b"1", format=form))
    assert bench.codes() == ["pixel_format", "", ""]
    assert bench.replies[0].error is not None
    assert bench.replies[0].error.message == "stream 'camera' takes pixels of yuyv, not rgb"


def test_who_cancels_is_told_the_status(bench: Bench) -> None:
    bench.ask(rq.CancelChange())
    assert [reply.body for reply in bench.replies] == [bench.services.status()]


def test_a_status_tells_what_each_client_has_if_it_is_asked_for(bench: Bench) -> None:
    for clients in (False, True):
        bench.ask(rq.ReadStatus(clients=clients))
    quiet, told = (reply.body for reply in bench.replies)
    assert isinstance(quiet, Status)
    assert isinstance(told, Status)
    assert quiet.clients == ()
    assert told.clients == (
        ClientStatus("pid 9 (view)", slots=3),
        ClientStatus(NAME, connections=2, leases=1, memory_bytes=5, account="uid:0"),
    )
    assert told.leases == quiet.leases


@pytest.mark.parametrize("write", [False, True])
@pytest.mark.parametrize("error", [None, GONE])
def test_a_read_of_memory_begins_when_there_is_room_for_its_answer_and_a_write_at_once(
    bench: Bench, write: bool, error: Exception | None
) -> None:
    bench.transfer.write, bench.transfer.length = write, 40_000
    bench.transfer.step, pieces = lambda: not pieces or pieces.pop(), [False]
    steps: list[Any] = []
    bench.services.turns.start = lambda _, made: steps.append(made)
    bench.client.make(USUAL.replies_bytes)
    bench.ask(rq.WriteData("ram", b"1", offset=4) if write else rq.ReadData("ram", offset=4, length=8))
    if not write:
        assert [next(steps[0]), next(steps[0])] == [NOT_YET] * 2
    bench.client.make(-USUAL.replies_bytes)
    assert (next(steps[0]), bench.client.unread_bytes, bench.replies) == (None, 0 if write else 40_000, [])
    bench.error = error
    if error is not None:
        bench.transfer.step = bench._step
    assert next(steps[0], "ended") == "ended"
    assert (bench.codes(), bench.client.unread_bytes) == (["device_gone" if error else ""], 0)


@pytest.mark.parametrize("long", [False, True])
@pytest.mark.parametrize(("asked", "loaded"), [("camera", False), ("", True)])
def test_a_configuration_is_described_with_counts_and_memories_a_long_one_beside_the_loop(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, long: bool, asked: str, loaded: bool
) -> None:
    config, manager = object(), bench.services.manager
    monkeypatch.setattr(handlers, "is_long", lambda found: found is config and long)
    manager.configs = {"camera": config}
    manager.describe = lambda name, counts: ConfigInfo(f"{name} {counts}", mode="on" if loaded else "")
    manager.memories.defined = lambda: (MemoryInfo("ram", 0, 4),)
    bench.ask(rq.ReadConfig(asked))
    assert bench.started == [bench.client] * long
    (reply,) = bench.replies
    told = decode_reply(encode_reply(b"cm_read_config", reply, 1)).body
    assert isinstance(told, ConfigInfo)
    assert (told.name, [memory.name for memory in told.memories]) == (f"{asked} {{'done': 3}}", ["ram"] * loaded)


# ---- configurations that were sent ---------------------------------------------------------------


def config(name: str) -> str:
    return f"config: {{name: {name}, modules: {{m: {{}}}}, modes: {{only: {{modules: [m]}}}}}}"


@pytest.fixture
def sent() -> Any:
    """Anna's, one of an administrator's under whose name Anna had sent one, and one of which nothing is known."""
    users = Users({1000: "anna", 1001: "ben"}.get, lambda *_: (), 500)  # type: ignore[arg-type]
    some = Grant(Role.PROVISION, configs=("a*",))
    access = Access(users={"anna": ("some",), "ben": ("admin",)}, roles={"some": some})
    manager: Any = SimpleNamespace(
        configs={name: loads(config(name)) for name in ("a", "b", "c")},
        check_replaceable=lambda name: (_ for _ in ()).throw(ChangeBusy(f"{name} is loaded")) if name == "ab" else None,
        in_use=lambda name: name == "ab",
    )
    provisioner: Any = SimpleNamespace(
        owned={"a": Owned("uid:1000", "anna", 123, 7), "b": Owned("uid:1000", "anna", 5)}, reserved=frozenset("b")
    )
    gate = Gate(access, users)
    return SimpleNamespace(manager=manager, provisioner=provisioner, connections=SimpleNamespace(gate=gate))


def test_all_configurations_are_listed_with_who_sent_them_and_how_much(sent: Any) -> None:
    all_of_them: Any = list_configs(sent).body
    assert all_of_them.names == ("a", "b", "c")
    assert [(entry.name, entry.origin, entry.owner, entry.bytes) for entry in all_of_them.entries] == [
        ("a", "client", "anna", 123),
        ("b", "administrator", "", 0),
        ("c", "administrator", "", 0),
    ]


def test_who_sends_may_do_so_under_names_of_their_own(sent: Any) -> None:
    anna, ben = "ipc:1000:0:7", "ipc:1001:0:8"
    assert sender_of(sent, anna) == Sender("uid:1000", "anna (uid 1000, pid 7)")
    assert sender_of(sent, ben) == Sender("uid:1001", "ben (uid 1001, pid 8)", admin=True)
    name_check(sent, anna)("aa")
    name_check(sent, ben)("b")
    with pytest.raises(Forbidden, match=r"anna .* no right to cm_write_config on configuration 'b'; .* role provision"):
        name_check(sent, anna)("b")
    with pytest.raises(ChangeBusy, match="ab is loaded"):
        name_check(sent, anna)("ab")


def test_a_configuration_that_is_in_use_is_not_removed(bench: Bench) -> None:
    manager = bench.services.manager
    manager.in_use, manager.leases = lambda name: name == "ab", SimpleNamespace(check=lambda *_: None)
    bench.ask(rq.RemoveConfig("ab"))
    assert bench.replies[0].error == ErrorInfo("busy", "configuration 'ab' is in use; load another first")
