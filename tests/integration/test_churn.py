# SPDX-License-Identifier: Apache-2.0
"""Clients that keep the manager changing, planning and storing, beside a client of another account.

Over TCP without keys a client is of another account than over ipc. Counts and order are asserted, never times.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import zmq
from daemon_thread import Daemon, daemon
from flood import running
from manager_process import CAMERA, environment, until

from cm.manager.execution.worker import Change, Worker
from cm.manager.manager import Manager
from cm.server.long_work import ClientJobs
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ConfigInfo, Reply
from cm.wire.plane_packets import Open, encode_open

pytestmark = pytest.mark.soak
# Opens many connections to the data socket, says nothing, and reports when all but a few have been closed.
CONNECTS = """
import socket, sys
made = []
for _ in range(int(sys.argv[2])):
    made.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    made[-1].connect(sys.argv[1])
for one in made[: -int(sys.argv[3])]:
    assert one.recv(1) == b""
print("hung up", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def served() -> Iterator[Daemon]:
    with daemon(load="camera/default", listen=("tcp://127.0.0.1:0",)) as made:
        until(lambda: made.status.mode == "default" and not made.status.fpga_busy)
        yield made


class Client:
    """Sends requests ahead, and reads the replies by their numbers."""

    def __init__(self, context: zmq.Context[Any], address: str) -> None:
        self._socket = context.socket(zmq.DEALER)
        self._socket.connect(address)

    def ask(self, *requests: rq.Request) -> None:
        for number, request in enumerate(requests):
            self._socket.send_multipart([b"%d" % number, b"", *encode_request(request)])

    def replies(self, count: int) -> dict[int, Reply]:
        found = {}
        for _ in range(count):
            assert self._socket.poll(60_000)
            frames = self._socket.recv_multipart()
            found[int(bytes(frames[0]))] = decode_reply(frames[2:])
        return found

    def codes(self, count: int) -> list[str]:
        return [r.error.code if r.error else "ok" for _, r in sorted(self.replies(count).items())]


@pytest.fixture
def hostile(served: Daemon, context: zmq.Context[Any]) -> Client:
    return Client(context, f"ipc://{served.folder}/run/req")


@pytest.fixture
def other(served: Daemon, context: zmq.Context[Any]) -> Client:
    return Client(context, served.server._sockets.tcp[0].req)


def change(number: int) -> rq.ChangeMode:
    return rq.ChangeMode("camera", ("edge_detection", "colorise", "default")[number % 3], no_wait=True)


def test_a_client_that_fills_the_queue_of_changes_leaves_places_to_others(
    served: Daemon, hostile: Client, other: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, goes_on, ended, outcome = threading.Event(), threading.Event(), [], Worker._outcome

    def held(worker: Worker, change: Change) -> Any:
        began.set()
        assert goes_on.wait(60)
        ended.append(change.number)
        return outcome(worker, change)

    monkeypatch.setattr(Worker, "_outcome", held)
    hostile.ask(*[change(i) for i in range(40)])
    codes = hostile.codes(40)
    assert codes == ["ok"] * 7 + ["busy"] * 33
    assert began.wait(60)  # one of them runs, and the others wait
    other.ask(change(1), change(2))
    assert other.codes(2) == ["ok", "ok"]
    goes_on.set()
    until(lambda: len(ended) == 9)
    until(lambda: not served.status.fpga_busy)
    hostile.ask(*[change(i) for i in range(7)])
    assert hostile.codes(7) == ["ok"] * 7  # all places were given back
    until(lambda: len(ended) == 16)


def test_a_plan_waits_for_two_tasks_of_another_client_and_not_for_all(
    served: Daemon, hostile: Client, other: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on, began, done, run = threading.Event(), threading.Event(), [], ClientJobs._run

    def noted(jobs: ClientJobs, *work: Any) -> None:
        began.set()
        assert goes_on.wait(60)
        run(jobs, *work)

    def planned(manager: Manager, change: rq.ChangeMode) -> Any:
        done.append(change.mode)
        return plan(manager, change)

    plan = Manager.plan
    monkeypatch.setattr(Manager, "plan", planned)
    monkeypatch.setattr(ClientJobs, "_run", noted)
    hostile.ask(*[rq.PlanChange("camera", "edge_detection")] * 60)
    assert began.wait(60)
    other.ask(rq.PlanChange("camera", "colorise"))
    until(lambda: len(served.server._jobs._waiting) == 2)
    goes_on.set()
    assert other.codes(1) == ["ok"]
    assert hostile.codes(60) == ["ok"] * 60
    assert done.index("colorise") <= 2  # the one that ran, and the one whose turn it was
    assert len(done) == 61


def test_a_long_configuration_is_described_outside_the_loop(
    served: Daemon, hostile: Client, other: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For 24,000 registers it takes 0.15 s."""
    threads: list[str] = []
    describe = Manager.describe

    def noted(manager: Manager, name: str, counts: Mapping[str, int]) -> ConfigInfo:
        threads.append(threading.current_thread().name)
        return describe(manager, name, counts)

    monkeypatch.setattr(Manager, "describe", noted)
    lines = "".join(f"          r{i}: {{offset: {4 * i:#x}}}\n" for i in range(3000))
    schema = (
        "config:\n  name: long\n  regions: [left]\n  modules: {fir: {region: left}}\n"
        "  modes: {only: {modules: [fir]}}\n"
        f"  mmio:\n    - base_address: 0x20000\n      registers:\n{lines}"
    )
    hostile.ask(rq.Provision(schema))
    assert hostile.codes(1) == ["ok"]
    hostile.ask(*[rq.ReadConfig("long")] * 100)
    replies = hostile.replies(100)
    told = [reply.body for reply in replies.values() if reply.error is None]
    assert 64 <= len(told) < 100  # more do not wait
    assert {len(body.registers) for body in told} == {3000}
    assert {reply.error.code for reply in replies.values() if reply.error} == {"busy"}
    assert set(threads) == {"cm-files_0"}
    other.ask(rq.ReadConfig("camera"), rq.ReadConfig("long"), rq.ReadConfig("none"))
    assert other.codes(3) == ["ok", "ok", "unknown_config"]
    assert threads.count("cm-files_0") == len(threads) - 2  # a short one, and none, are not worth a thread


def test_settings_are_reread_after_one_task_however_many_wait(
    served: Daemon, hostile: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a client that is about to lose a right could delay that."""
    goes_on, began, order, run = threading.Event(), threading.Event(), [], ClientJobs._run

    def noted(jobs: ClientJobs, *work: Any) -> None:
        began.set()
        assert goes_on.wait(60)
        order.append("work")
        run(jobs, *work)

    monkeypatch.setattr(ClientJobs, "_run", noted)
    schema = (CAMERA / "camera.yaml").read_text("utf-8").replace("name: camera", "name: mine", 1)
    hostile.ask(*[rq.Provision(schema)] * 30)
    assert began.wait(60)
    read = served.server._jobs.thread.submit(order.append, "settings")
    goes_on.set()
    read.result(60)
    assert order.index("settings") == 1
    assert hostile.codes(30) == ["ok"] * 30


def test_a_client_that_keeps_connecting_to_the_data_socket_displaces_nobody(served: Daemon) -> None:
    path = served.folder / "run" / "data"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as ours:
        ours.settimeout(60)
        ours.connect(str(path))
        with running("-c", CONNECTS, path, 400, 48, first="hung up"):
            until(lambda: len(served.server._data_socket._awaiting) == 49)
            ours.send(encode_open(Open("", echo=True, length=4096, depth=1)))
            assert ours.recv(4096)


def test_what_a_manager_has_made_when_it_is_ready_is_never_looked_through_for_garbage(tmp_path: Path) -> None:
    """Full collections took 15 to 30 ms of its loop, the first of them when the first flood came."""
    code = (
        "import gc, sys\nfrom cm.server.server import Server\nfrom cm.cli.main import main\n"
        "Server.serve = lambda self, ready: (ready(), self._close())\n"
        "status = main(sys.argv[1:])\n"
        "print(status, gc.get_freeze_count() > 20_000, len(gc.get_objects()) < 5_000)"
    )
    words = ["serve", "--config", str(CAMERA), "--runtime-dir", str(tmp_path / "r"), "--state-dir", str(tmp_path / "s")]
    said = subprocess.run(
        [sys.executable, "-c", code, *words], env=environment(), capture_output=True, text=True, timeout=60, check=True
    )
    assert said.stdout == "0 True True\n"
