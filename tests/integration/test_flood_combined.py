# SPDX-License-Identifier: Apache-2.0
"""All floods at once from one process, beside a well-behaved client: what `cm bench flood` measures, as a test.

Only times of the same run are compared: the slowest answer with the loop's longest slice in that run.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from daemon_thread import Daemon
from flood import descriptors, resident_mib, running
from manager_process import CAMERA, short_folder, until

import cm
from cm.server import sockets as loops
from cm.simulation.software import Board as SimBoard

pytestmark = pytest.mark.soak
SLICES = 64  # of the loop, in the slowest answer
BESIDE = 64  # MiB

# Writes and reads back until its input ends; the number of its requests, and the slowest answer in seconds.
BEHAVES_WELL = """
import json, select, sys, time
import cm
slowest, asked = 0.0, 0
with cm.connect(runtime_dir=sys.argv[1], timeout=60) as board:
    print("begun", flush=True)
    while asked < 1000 or not select.select([sys.stdin], [], [], 0)[0]:
        began = time.monotonic()
        if asked % 2:
            assert board.registers["focus"] == (asked - 1) // 2 % 16, asked
        else:
            board.registers["focus"] = asked // 2 % 16
        slowest = max(slowest, time.monotonic() - began)
        asked += 1
print(json.dumps({"asked": asked, "slowest": slowest}))
"""


class Slices:
    """Measures the longest time for which a daemon's loop did not look at its sockets."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.longest = 0.0
        self._since = 0.0
        poll = loops.zmq_poll

        def watched(sources: Sequence[Any], milliseconds: int) -> Any:
            if len(sources) < 2:  # one socket that is looked at, within a turn
                return poll(sources, milliseconds)
            self.longest = max(self.longest, time.monotonic() - self._since if self._since else 0.0)
            found = poll(sources, milliseconds)
            self._since = time.monotonic()
            return found

        patch.setattr(loops, "zmq_poll", watched)


def ended(process: subprocess.Popen[str]) -> Any:
    """Its output when its input ends."""
    said, _ = process.communicate(timeout=600)
    return json.loads(said)


def test_beside_everything_at_once_a_client_is_served_and_all_is_idle_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cm.server.uploads.IDLE", 2.0)  # seconds, of 60
    slices = Slices(monkeypatch)
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        daemon = Daemon(folder, sim, load="camera/default")
        try:
            _floods(folder / "run", slices)
        finally:
            daemon.close()


def _floods(runtime: Path, slices: Slices) -> None:
    with running("-c", BEHAVES_WELL, str(runtime), first="begun") as quiet:
        alone = ended(quiet)
    before, had = resident_mib(os.getpid()), descriptors(os.getpid())
    slices.longest = 0.0
    with (
        running("-c", BEHAVES_WELL, str(runtime), first="begun") as client,
        running("-m", "cm.tools.bench.flooding", str(runtime), first="flooding") as flood,
    ):
        with cm.connect(runtime_dir=runtime, timeout=60) as board:

            def attacker() -> Any:
                (found,) = [one for one in board.clients() if one.name.startswith(f"pid {flood.pid} ")]
                return found

            def at_work() -> Any:
                """Connections are counted in a part of the loop's time, and uploads come and go."""
                found = attacker()
                return found if found.connections > 200 and found.slots == 64 and found.upload_bytes else None

            hostile = until(at_work, 60)
            assert hostile.leases <= 32
            assert hostile.waiting_bytes > 0
        assert resident_mib(os.getpid()) < before + BESIDE
        beside, told = ended(client), ended(flood)
    assert beside["asked"] >= 1000
    assert told["answered"] == told["asked"] > 400
    assert told["packets"] > 1000
    assert {"too_many", "too_many_leases", "ok"} <= told["codes"].keys()
    assert beside["slowest"] <= SLICES * slices.longest, (alone, beside, slices.longest)
    until(lambda: descriptors(os.getpid()) <= had + 8, 60)
    assert resident_mib(os.getpid()) < before + BESIDE
    with cm.connect(runtime_dir=runtime, timeout=60) as board:
        until(lambda: not [one for one in board.clients() if one.name.startswith(f"pid {flood.pid} ")], 60)
        until(lambda: not board.status.leases, 60)
    print(json.dumps({"alone": alone, "beside": beside, "longest": slices.longest, "flood": told}))
