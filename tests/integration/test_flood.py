# SPDX-License-Identifier: Apache-2.0
"""Floods beside a well-behaved client: on this machine only, and bounded in count.

Only counts within one run are asserted, never times: how many units of others' work the loop does in one turn, that
every request of the other client is answered, and the memory and descriptors in use after the flood.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zmq
from flood import descriptors, idle_connections, resident_mib
from manager_process import Manager, served, short_folder, until

import cm
from cm.device import Root
from cm.manager.access.register_bus import RegisterBus
from cm.schema import load_folder
from cm.server import server as daemon
from cm.server.options import Options
from cm.server.sockets import Loop
from cm.simulation.software import Board as SimBoard
from cm.wire import cm_pb2 as pb
from cm.wire.encode import encode_request
from cm.wire.messages import requests as rq

pytestmark = pytest.mark.soak
AT_ONCE, PIECE = 32, 16  # registers of a request in one go, and in a piece of a longer one
REGISTERS = "\n".join(f"          r{i}: {{offset: {4 * i:#x}}}" for i in range(200))
SCHEMA = f"""
config:
  name: many
  regions: [left]
  modules: {{fir: {{region: left}}}}
  mmio:
    - base_address: 0x20000
      registers:
{REGISTERS}
  memories: {{big: {{base_address: 0x10000000, size: 0xA00000}}}}
  modes: {{default: {{modules: [fir]}}}}
"""


class Turns:
    """The accesses to registers in each turn of a loop."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.most = self.all = self._now = 0
        wait = Loop._wait

        def turn(loop: Loop, milliseconds: int) -> None:
            self.most, self._now = max(self.most, self._now), 0
            wait(loop, milliseconds)

        patch.setattr(Loop, "_wait", turn)
        for name in ("read_address", "write_address"):
            patch.setattr(RegisterBus, name, self._counted(getattr(RegisterBus, name)))

    def _counted(self, access: Any) -> Any:
        def counted(*arguments: Any) -> Any:
            self._now += 1
            self.all += 1
            return access(*arguments)

        return counted


@contextmanager
def serving(folder: Path, root: Path, schemas: Path) -> Iterator[Path]:
    options = Options(folder / "run", folder / "state", Root.of(root), load_folder(schemas), load="many/default")
    ready = threading.Event()
    server = daemon.Server(options)
    thread = threading.Thread(target=server.serve, args=(ready.set,))
    thread.start()
    try:
        assert ready.wait(60)
        yield options.runtime_dir
    finally:
        server.stop()
        thread.join()


def test_no_turn_of_the_loop_does_more_than_a_slice_of_one_request(
    monkeypatch: pytest.MonkeyPatch, context: zmq.Context[Any]
) -> None:
    turns = Turns(monkeypatch)
    with short_folder() as folder:
        (folder / "schemas").mkdir()
        (folder / "schemas" / "many.yaml").write_text(SCHEMA, encoding="utf-8")
        with (
            SimBoard([folder / "schemas"], root=folder / "board") as sim,
            serving(folder, sim.root, folder / "schemas") as runtime,
            cm.connect(runtime_dir=runtime, timeout=60) as board,
        ):
            board.load("many", "default")
            turns.most = turns.all = 0
            flood = context.socket(zmq.DEALER)
            flood.connect(f"ipc://{runtime}/req")
            writes = tuple(rq.RegWrite(f"r{i % 200}", i) for i in range(1024))
            for _ in range(8):
                flood.send_multipart(encode_request(rq.WriteReg(writes)))
            too_many = pb.WriteReg(writes=[pb.RegWrite(name="r0", value=1)] * 100_000).SerializeToString()
            for message in (too_many, b"{" + b"'a':1," * 10_000 + b"}", b"{'r0':0x" + b"f" * 5000 + b"}"):
                flood.send_multipart([b"cm_write_reg", message])
            answered = [board.registers["r199"] for _ in range(100)]
            assert len(answered) == 100
            for _ in range(11):
                assert flood.poll(60_000)
                flood.recv_multipart()
            assert turns.all >= 8 * 1024
            # a piece, and one request of each of the two clients: a write reads back what it wrote
            assert turns.most <= 2 * PIECE + 2 * AT_ONCE


# Sends requests over each of its connections when told to, and reads all answers.


@pytest.fixture
def manager() -> Iterator[Manager]:
    with served() as (made, _):
        with made.connected() as board:
            board.load("camera", "default")
        yield made


def test_a_client_beside_all_floods_at_once_loses_no_request_and_all_is_idle_afterwards(
    manager: Manager, context: zmq.Context[Any]
) -> None:
    before, had = resident_mib(manager.pid), descriptors(manager.pid)
    done = threading.Event()
    answered: list[int] = []
    failed: list[Exception] = []

    def behaves_well() -> None:
        try:
            with manager.connected() as board:
                while not done.is_set() or len(answered) < 200:
                    board.registers["focus"] = len(answered) % 16
                    answered.append(int(board.registers["focus"]))
        except Exception as error:  # noqa: BLE001 (told in the test's own thread)
            failed.append(error)

    other = threading.Thread(target=behaves_well)
    other.start()
    try:
        with idle_connections(manager.runtime / "req", 200, 3):
            flood = context.socket(zmq.DEALER)
            flood.setsockopt(zmq.SNDHWM, 0)
            flood.connect(f"ipc://{manager.runtime}/req")
            subscriber = context.socket(zmq.SUB)
            subscriber.connect(f"ipc://{manager.runtime}/pub")
            for i in range(900):
                subscriber.setsockopt(zmq.SUBSCRIBE, b"cm_nothing/%d" % i)
            count = 0
            for _ in range(50):
                for message in (b"{" * 60_000, b"{'a':" + b"9" * 60_000 + b"}", b"\xff" * 100_000):
                    flood.send_multipart([b"cm_write_reg", message])
                    count += 1
                for request in (rq.ReadReg(), rq.TakeLease("registers:zoom"), rq.ReadStatus(clients=True)):
                    flood.send_multipart(encode_request(request))
                    count += 1
            for _ in range(count):
                assert flood.poll(60_000)
                flood.recv_multipart()
            assert resident_mib(manager.pid) < before + 64
            flood.close(0)
            subscriber.close(0)
    finally:
        done.set()
        other.join()
    assert failed == []
    assert answered == [i % 16 for i in range(len(answered))]
    until(lambda: descriptors(manager.pid) <= had + 16, 60)
    assert resident_mib(manager.pid) < before + 64
