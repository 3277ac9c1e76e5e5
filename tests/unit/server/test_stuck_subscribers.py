# SPDX-License-Identifier: Apache-2.0
"""Which connections are ended: those that do not read, that take too much, that were named, or lost their rights."""

from __future__ import annotations

import os
import resource
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from manager_process import CAMERA

from cm.errors import Forbidden
from cm.schema import load_folder
from cm.server.connections import Connections, raise_descriptors
from cm.server.rights.admission import Gate
from cm.server.rights.model import Access, AuthorizedKey, Grant, Role
from cm.server.rights.policy import Users
from cm.server.rights.principal import introduced, of_process
from cm.wire.plane_packets import Open, Purpose
from cm.wire.topics import Endpoints

PIECE = bytes(1000)


class Subscriber:
    """A connection to the manager's socket for publications, with both of its ends here."""

    def __init__(self, listener: socket.socket) -> None:
        self._theirs = socket.socket(socket.AF_UNIX)
        self._theirs.connect(listener.getsockname())
        self._ours = listener.accept()[0]
        self._theirs.setblocking(False)
        for _ in range(5):
            self._ours.send(PIECE)

    @property
    def fd(self) -> int:
        return self._ours.fileno()

    def takes(self) -> bytes:
        return self._theirs.recv(len(PIECE))

    @property
    def ended(self) -> bool:
        """Whether what came is followed by an end."""
        try:
            while self._theirs.recv(1 << 16):
                pass
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        self._ours.close()
        self._theirs.close()


@pytest.fixture
def two(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Subscriber, Subscriber]]:
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "pub"))
        listener.listen()
        made = Subscriber(listener), Subscriber(listener)
        yield made
        for one in made:
            one.close()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("cm.server.connections.time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def test_of_two_subscribers_the_one_that_takes_nothing_is_ended(
    tmp_path: Path, two: tuple[Subscriber, Subscriber], clock: list[float], caplog: pytest.LogCaptureFixture
) -> None:
    slow, stuck = two
    watched = connections(tmp_path)
    for _ in range(3):
        watched.end_stuck()
        assert slow.takes() == PIECE
        clock[0] += 0.06
    assert [slow.ended, stuck.ended] == [False, True]
    told = f"a subscriber of pid {os.getpid()} was ended: it left frames unread for longest (streams.queue_mib)"
    assert caplog.messages == [told]


def test_nobody_is_ended_for_what_was_unread_a_moment_ago(
    tmp_path: Path, two: tuple[Subscriber, Subscriber], clock: list[float]
) -> None:
    watched = connections(tmp_path)
    for _ in range(100):  # asked again and again
        watched.end_stuck()
    clock[0] += 0.06
    watched.end_stuck()
    assert [one.ended for one in two] == [False, False]  # and have read all
    clock[0] += 10.0
    watched.end_stuck()
    assert [one.ended for one in two] == [False, False]


def test_connections_are_counted_by_where_they_lead(tmp_path: Path, two: tuple[Subscriber, Subscriber]) -> None:
    assert len(two) == 2
    assert connections(tmp_path).counted() == {f"pid {os.getpid()}": 2}
    assert connections(tmp_path / "elsewhere").counted() == {}


@pytest.mark.parametrize(("descriptors", "ended"), [(4, True), (12, False), (1 << 20, False)])
def test_a_client_that_takes_up_the_descriptors_loses_its_connections(
    tmp_path: Path,
    two: tuple[Subscriber, Subscriber],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    descriptors: int,
    ended: bool,
) -> None:
    monkeypatch.setattr("cm.server.connections.resource.getrlimit", lambda _: (descriptors, descriptors))
    connections(tmp_path).settle()
    assert [one.ended for one in two] == [ended, ended]
    told = f"2 connections of pid {os.getpid()} were ended: they take up the descriptors (RLIMIT_NOFILE)"
    assert caplog.messages == [told] * ended


@pytest.mark.parametrize(
    ("pid", "uid", "ended"), [(0, 0, True), (1, 0, False), (0, 1, False)], ids=["its own", "another pid", "another uid"]
)
def test_a_process_that_subscribes_to_too_much_loses_that_connection(
    two: tuple[Subscriber, Subscriber], caplog: pytest.LogCaptureFixture, pid: int, uid: int, ended: bool
) -> None:
    whose = of_process("ipc", os.getuid() + uid, os.getgid(), os.getpid() + pid).id
    Connections.end(two[0].fd, whose)
    assert [one.ended for one in two] == [ended, False]
    assert caplog.messages == [f"a connection of {whose} was ended: it subscribes to too much"] * ended


@pytest.mark.parametrize(("address", "ended"), [("127.0.0.1", True), ("127.0.0.2", False), ("127.0.0.11", False)])
@pytest.mark.parametrize("mechanism", ["NULL", "CURVE"])
def test_a_client_over_tcp_is_known_by_its_address(mechanism: str, address: str, ended: bool) -> None:
    who = introduced("tcp" if mechanism == "NULL" else "curve", address, mechanism, "k" * 40)
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as theirs:
        ours, _ = listener.accept()
        theirs.setblocking(False)
        with ours:
            Connections.end(ours.fileno(), who.id)
            try:
                assert (theirs.recv(1) == b"") == ended
            except BlockingIOError:
                assert not ended


def test_a_connection_that_has_gone_is_left_alone(two: tuple[Subscriber, Subscriber]) -> None:
    Connections.end(1 << 20, of_process("ipc", os.getuid(), os.getgid(), os.getpid()).id)
    assert [one.ended for one in two] == [False, False]


# ---- rights of connections -----------------------------------------------------------------------

USERS = Users({1000: "anna"}.get, lambda *_: (), 500)  # type: ignore[arg-type]
KEY = "k" * 40
ANYONE = Access()


@pytest.fixture
def anna(monkeypatch: pytest.MonkeyPatch) -> None:
    """All connections are hers."""
    monkeypatch.setattr("cm.server.connections.credentials", lambda _: (77, 1000, 1000))


def connections(folder: Path, access: Access = ANYONE, tcp: tuple[Endpoints, ...] = (), **gate: Any) -> Connections:
    camera = load_folder(CAMERA)["camera"]
    state = SimpleNamespace(config="camera", mode="default", modules={})
    manager: Any = SimpleNamespace(
        loaded_config=lambda: camera, configs={"camera": camera}, state=state, running=None, coming=None
    )
    made = Connections(Gate(access, USERS, **gate), folder, list(tcp))
    made.begin(manager)
    return made


@pytest.mark.usefixtures("anna")
@pytest.mark.parametrize(
    ("said", "ended"),
    [({"users": {"anna": ()}}, True), ({"local": ("observe",)}, True), ({"users": {"ben": ()}}, False), ({}, False)],
)
def test_who_loses_or_gains_rights_is_disconnected_and_nobody_else(
    tmp_path: Path, two: tuple[Subscriber, ...], caplog: pytest.LogCaptureFixture, said: dict[str, Any], ended: bool
) -> None:
    connections(tmp_path / "elsewhere", Access()).renew(Access(**said))
    assert [one.ended for one in two] == [False, False]
    connections(tmp_path, Access()).renew(Access(**said))
    assert [one.ended for one in two] == [ended, ended]
    assert caplog.messages == ["rights have changed: 2 connections ended"] * ended


@pytest.mark.parametrize(("port", "address"), [(0, "127.0.0.1"), (1, "127.0.0.1"), (0, "127.0.0.2")])
def test_the_holder_of_a_key_that_has_expired_is_disconnected(tmp_path: Path, port: int, address: str) -> None:
    clock = [0.0]
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as theirs:
        ours, _ = listener.accept()
        at = f"tcp://127.0.0.1:{listener.getsockname()[1] + port}"
        access = Access(keys=(AuthorizedKey(KEY, "laptop", ("observe",), 10.0),))
        known = connections(
            tmp_path, access, (Endpoints("tcp://127.0.0.1:1", "tcp://127.0.0.1:2", at),), now=lambda: clock[0]
        )
        known.gate.enter("curve", address, "CURVE", KEY)
        theirs.setblocking(False)
        with ours:
            for clock[0] in (9.0, 11.0):
                known.end_expired()
                try:
                    assert theirs.recv(1) == b""
                    assert (clock[0], port, address) == (11.0, 0, "127.0.0.1")
                except BlockingIOError:
                    assert (clock[0], port, address) != (11.0, 0, "127.0.0.1")


@pytest.mark.usefixtures("anna")
@pytest.mark.parametrize(
    ("wanted", "role", "on"),
    [
        (Open("camera"), "observe", "data on configuration 'camera', region 'prr0', data 'camera'"),
        (Open("to_pl", Purpose.WRITE), "operate", "data on configuration 'camera', region 'prr1', data 'to_pl'"),
        (Open("", Purpose.ALLOCATE), "operate", "data on configuration 'camera'"),
        (Open("", Purpose.ECHO), "observe", "data on configuration 'camera'"),
        (Open("default", Purpose.WINDOW), "map", "data on configuration 'camera', region 'prr0'"),
        (Open("", Purpose.REGISTERS), "observe", "everything"),
    ],
)
def test_what_a_connection_opens_takes_a_right_to_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, wanted: Open, role: str, on: str
) -> None:
    ours, theirs = socket.socketpair()
    needed = Role[role.upper()]
    with ours, theirs:
        for given in Role:
            topics = ("*",) if on == "everything" else ("data",)
            access = Access(local=("one",), roles={"one": Grant(given, topics=topics)})
            if given >= needed:
                (made := connections(tmp_path, access)).check_open(made.whose(ours), wanted)
                continue
            with pytest.raises(Forbidden) as refused:
                (made := connections(tmp_path, access)).check_open(made.whose(ours), wanted)
            said = f"anna (uid 1000, pid 77) has no right to {on}; it takes the role {role} there"
            assert str(refused.value) == said
            assert caplog.messages == [f"refused: {said}"]
            caplog.clear()
    assert connections(tmp_path, Access()).whose(ours) == "data:1000:1000:77"


@pytest.mark.parametrize(
    ("soft", "hard", "asked"),
    [
        (1024, 4096, 4096),
        (1024, 1 << 20, 65536),
        (1024, -1, 65536),
        (4096, 4096, None),
        (65536, -1, None),
        (-1, -1, None),
    ],
)
def test_as_many_descriptors_are_asked_for_as_may_be_had(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, asked: int | None
) -> None:
    set_to: list[object] = []
    monkeypatch.setattr("cm.server.connections.resource.getrlimit", lambda _: (soft, hard))
    monkeypatch.setattr("cm.server.connections.resource.setrlimit", lambda *given: set_to.append(given))
    raise_descriptors()
    assert set_to == ([] if asked is None else [(resource.RLIMIT_NOFILE, (asked, hard))])
