# SPDX-License-Identifier: Apache-2.0
"""What an idle manager costs: time to start, memory, processor."""

from __future__ import annotations

import statistics
import time
from contextlib import ExitStack
from importlib import resources
from pathlib import Path

from cm.simulation.software import Board
from cm.tools.bench.machine import unpinned
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run
from cm.tools.bench.serving import cpu_percent, proportional_mib, resident_mib, serve, settle

SECONDS = Goal(0.5)
MEMORY = Goal(48)
IDLE = Goal(0.5)
RAN = (
    "cm serve --sim, camera example: from the start of the process to its first reply, on all CPUs (the simulator "
    "starts beside it); memory and processor use of the manager's process in its mode, without readers"
)


def run(bench: Run) -> list[Result]:
    """Measure `footprint`."""
    starts, board_starts, cpu, resident, proportional = [], [], [], [], []
    with serve(bench):
        pass  # an installed package comes with its bytecode; here the first start makes it
    for _ in range(1 if bench.quick else 7):
        with ExitStack() as stack:
            stack.enter_context(unpinned(set(bench.cpus)))
            served = stack.enter_context(serve(bench))
            starts.append(served.seconds)
            cpu.append(served.cpu)
            with served.connect() as board:
                settle(board)
            time.sleep(0.5)  # what follows a change of mode (images are read ahead) is over before this counts
            idle = cpu_percent(served.pid, lambda: time.sleep(1.0 if bench.quick else 5.0))
            resident.append(resident_mib(served.pid))
            proportional.append(proportional_mib(served.pid))
        with _board(bench) as simulated, serve(bench, "--root", str(simulated.root), sim=False) as alone:
            board_starts.append(alone.seconds)
    memory = statistics.median(resident)
    details = {
        "samples": {"sim": starts, "on_a_board_that_runs": board_starts},
        "seconds_on_a_board_that_runs": statistics.median(board_starts),
        "cpu_seconds_to_first_reply": statistics.median(cpu),
        "memory_mib": memory,
        "memory_proportional_mib": statistics.median(proportional),
        "memory_goal": str(MEMORY),
        "memory_met": MEMORY.met(memory),
        "idle_cpu_percent": idle,
        "idle_cpu_goal": str(IDLE),
        "idle_cpu_met": IDLE.met(idle),
    }
    return [Result("footprint", statistics.median(starts), "s", RAN, goal=SECONDS, details=details)]


def _board(bench: Run) -> Board:
    """The camera example's board, with no manager on it."""
    return Board([Path(str(resources.files("cm").joinpath("data/camera")))], root=bench.place("b") / "board")
