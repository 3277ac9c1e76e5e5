# SPDX-License-Identifier: Apache-2.0
"""Client, manager and simulator are killed or stopped at random: afterwards the board works."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys

import pytest
from flood import descriptors
from manager_process import Manager, environment, served, until

from cm.errors import CmError

MODES = ("default", "edge_detection")
CLIENT = """
import sys, cm
from pathlib import Path
with cm.connect(runtime_dir=Path(sys.argv[1]), timeout=60) as board:
    print("ready", flush=True)
    while True:
        board.registers["focus"] = 3
        board.read("camera", timeout=60)
"""


def works(manager: Manager, mode: str) -> bool:
    try:
        with manager.connected() as board:
            board.load("camera", mode, timeout=60)
            board.registers["focus"] = 5
            return board.registers["focus"] == 5 and board.mode == mode
    except CmError:
        return False


def client_of(manager: Manager) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", CLIENT, str(manager.runtime)]
    made = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert made.stdout is not None
    made.stdout.readline()
    return made


@pytest.mark.timeout(3600)
def test_whatever_is_killed_or_stopped_the_board_works_afterwards(request: pytest.FixtureRequest) -> None:
    rounds = request.config.getoption("--rounds")
    draw = random.Random(13)
    with served() as (manager, sim):
        assert works(manager, "default")
        assert manager.process is not None
        had = descriptors(manager.process.pid)
        for number in range(rounds):
            client = client_of(manager)
            victim, blow = draw.choice(("client", "manager", "board")), draw.choice((signal.SIGKILL, signal.SIGSTOP))
            pid = {"client": client.pid, "manager": manager.process.pid, "board": sim.pid}[victim]
            os.kill(pid, blow)
            if blow == signal.SIGSTOP:
                os.kill(pid, signal.SIGCONT)
            elif victim == "manager":
                manager._reap()
                manager.start()
            elif victim == "board":
                sim.kill()
                sim.restart()
            client.kill()
            client.communicate()
            mode = MODES[number % 2]
            until(lambda mode=mode: works(manager, mode), 120)  # type: ignore[misc]
            assert manager.process is not None
        until(lambda: descriptors(manager.process.pid) <= had + 16, 60)  # type: ignore[union-attr]
