# SPDX-License-Identifier: Apache-2.0
"""Client, manager and simulator are killed or stopped at random: afterwards the board works."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from typing import Any

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


WRITER = """
import sys, cm
from pathlib import Path
with cm.connect(runtime_dir=Path(sys.argv[1]), timeout=20) as board:
    value = int(sys.argv[2])
    while True:
        board.registers["led"] = value % 256
        print(value % 256, flush=True)
        value += 1
"""
CHANGER = """
import sys, cm
from pathlib import Path
with cm.connect(runtime_dir=Path(sys.argv[1]), timeout=60) as board:
    while True:
        for mode in ("edge_detection", "default"):
            board.mode = mode
"""


@pytest.mark.timeout(3600)
def test_no_confirmed_value_is_lost_to_a_manager_that_is_killed(request: pytest.FixtureRequest) -> None:
    """What the writer was told last is there, or the one that it had asked for and was not told."""
    draw = random.Random(8)
    value = 1
    with served() as (manager, _):
        assert works(manager, "default")
        for number in range(request.config.getoption("--kills")):
            pipes: dict[str, Any] = {"env": environment(), "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
            runtime = str(manager.runtime)
            writer = subprocess.Popen([sys.executable, "-c", WRITER, runtime, str(value)], **pipes)
            changer = subprocess.Popen([sys.executable, "-c", CHANGER, runtime], **pipes)
            assert writer.stdout is not None
            first = writer.stdout.readline()
            time.sleep(draw.uniform(0.05, 0.6))  # anywhere in changes, which take some 30 ms each
            assert manager.process is not None
            manager.process.kill()
            # 20 s at most, where the connection had ended before the last request: that waits for another manager
            told = int((first + writer.communicate(timeout=60)[0]).split()[-1])
            changer.kill()
            changer.communicate()
            manager._reap()
            manager.start()
            with manager.connected() as board:
                until(lambda: not board.status.fpga_busy and board.status.mode != "")
                assert board.registers["led"] in (told, (told + 1) % 256), f"round {number}"
            value = told + 2


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
