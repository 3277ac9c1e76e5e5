# SPDX-License-Identifier: Apache-2.0
"""Floods beside a well-behaved client: on this machine only, and bounded in count.

Only counts within one run are asserted, never times: how many units of others' work the loop does in one turn,
and that every request of the other client is answered. All floods at once are in test_flood_combined.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import zmq
from daemon_thread import daemon

import cm
from cm.manager.access.register_bus import RegisterBus
from cm.server.sockets import Loop
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


def test_no_turn_of_the_loop_does_more_than_a_slice_of_one_request(
    monkeypatch: pytest.MonkeyPatch, context: zmq.Context[Any], tmp_path: Path
) -> None:
    turns = Turns(monkeypatch)
    (tmp_path / "many.yaml").write_text(SCHEMA, encoding="utf-8")
    with daemon(schemas=tmp_path) as made, cm.connect(runtime_dir=made.folder / "run", timeout=60) as board:
        board.load("many", "default")
        turns.most = turns.all = 0
        flood = context.socket(zmq.DEALER)
        flood.connect(f"ipc://{made.folder}/run/req")
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
