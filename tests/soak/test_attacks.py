# SPDX-License-Identifier: Apache-2.0
"""Each attack of `attacks.py` beside a well-behaved client, which loses nothing; afterwards all is idle."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import attacks
import pytest
from flood import descriptors, resident_mib, running
from keyed_manager import KeyedManager, served_with_keys
from manager_process import environment, until

BESIDE = 64  # MiB
KEPT = 90.0  # seconds in which all that an attacker began is gone: uploads stay for a minute

# Writes and reads back over one connection and reads frames over another, until its input ends.
NEIGHBOUR = """
import json, select, sys, threading, time
import cm
told = {"asked": 0, "frames": 0, "slowest": 0.0, "errors": []}
done, seen = threading.Event(), threading.Event()
def stream():
    try:
        with cm.connect(runtime_dir=sys.argv[1], timeout=60) as board, board.stream("camera", timeout=60) as frames:
            while not done.is_set():
                frames.read()
                told["frames"] += 1
                seen.set()
    except Exception as error:
        told["errors"].append(repr(error))
        seen.set()
thread = threading.Thread(target=stream, daemon=True)
with cm.connect(runtime_dir=sys.argv[1], timeout=60) as board:
    thread.start()
    seen.wait()  # an attacker of the same user may leave nothing for who comes later
    print("begun", flush=True)
    while not select.select([sys.stdin], [], [], 0)[0] or told["asked"] < 200:
        began = time.monotonic()
        board.registers["scratch"] = told["asked"]
        assert board.registers["scratch"] == told["asked"]
        told["slowest"] = max(told["slowest"], time.monotonic() - began)
        told["asked"] += 1
done.set()
thread.join()
print(json.dumps(told))
"""


@pytest.fixture
def guarded() -> Iterator[KeyedManager]:
    with served_with_keys() as made:
        yield made


def ended(process: subprocess.Popen[str]) -> Any:
    """Its output when its input ends."""
    said, _ = process.communicate(timeout=600)
    return json.loads(said)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", attacks.ATTACKS)
def test_another_client_loses_nothing(guarded: KeyedManager, name: str) -> None:
    with running("-c", NEIGHBOUR, guarded.manager.runtime, first="begun") as client:
        alone = ended(client)
    before, had = resident_mib(guarded.pid), descriptors(guarded.pid)
    words = [sys.executable, attacks.__file__, name, str(guarded.manager.runtime), "200"]
    with running("-c", NEIGHBOUR, guarded.manager.runtime, first="begun") as client:
        attacker = subprocess.Popen(
            [*words, guarded.manager.tcp("req"), str(guarded.keys)],
            env=environment(),
            stdout=subprocess.PIPE,
            text=True,
        )
        most = before
        while attacker.poll() is None:
            most = max(most, resident_mib(guarded.pid))
            assert client.poll() is None
        said, _ = attacker.communicate()
        beside = ended(client)
    print(name, said.splitlines()[-1], {"alone": alone, "beside": beside, "MiB": (before, most)})
    assert attacker.returncode == 0
    assert beside["errors"] == []
    assert most < before + BESIDE
    until(lambda: descriptors(guarded.pid) <= had + 8, KEPT)
    assert resident_mib(guarded.pid) < before + BESIDE
    with guarded.manager.connected() as board:
        until(lambda: board.status.leases == (), KEPT)  # those of a process that is gone end by their time
        board.load("camera", "default", timeout=60)


@pytest.mark.timeout(900)
def test_new_clients_come_in_beside_processes_that_connect_without_end(guarded: KeyedManager) -> None:
    words = [sys.executable, attacks.__file__, "connect_without_end", str(guarded.manager.runtime), "200"]
    with subprocess.Popen([*words, guarded.manager.tcp("req")], env=environment(), stdout=subprocess.PIPE) as attacker:
        came = 0
        while attacker.poll() is None or came < 20:
            with guarded.manager.connected() as board:
                board.registers["scratch"] = came
                assert board.registers["scratch"] == came
            came += 1
    print("new clients", came)
    assert attacker.returncode == 0
