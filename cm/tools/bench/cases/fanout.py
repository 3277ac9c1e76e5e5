# SPDX-License-Identifier: Apache-2.0
"""One producer, 1 to 8 local readers: what each reader costs the others."""

from __future__ import annotations

import statistics
import subprocess
from contextlib import ExitStack
from importlib import resources
from pathlib import Path

from cm import child
from cm.tools.bench.machine import unpinned
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run
from cm.tools.bench.serving import serve, settle

READERS = (1, 2, 4, 8)
RATE = 200.0  # frames per second that the simulated camera gives
GOAL = Goal(0.9, at_least=True)
RAN = (
    "simulated camera of 200 frames per second (640 × 480), 1, 2, 4 and 8 local readers, each a process that looks at "
    "every frame; frames per second that a reader got, all CPUs; ratio: rate with 8 readers to rate with one"
)


def run(bench: Run) -> list[Result]:
    """Measure `fanout`."""
    with ExitStack() as stack:
        stack.enter_context(unpinned(set(bench.cpus)))
        served = stack.enter_context(serve(bench, "--config", str(_fast_camera(bench)), "--load", "camera"))
        board = stack.enter_context(served.connect())
        settle(board)
        seconds = 0.5 if bench.quick else 5.0
        found = {count: _readers(str(served.runtime_dir), count, seconds) for count in READERS}
    rates = {count: statistics.median(rate for rate, _ in each) for count, each in found.items()}
    details = {
        "rates": {str(count): rate for count, rate in rates.items()},
        "lost": {str(count): sum(lost for _, lost in each) for count, each in found.items()},
    }
    return [Result("fanout", rates[8], "frames/s", RAN, rates[1], rates[8] / rates[1], GOAL, details=details)]


def _fast_camera(bench: Run) -> Path:
    """The camera example's schema with a faster camera."""
    text = resources.files("cm").joinpath("data/camera/camera.yaml").read_text(encoding="utf-8")
    path = bench.place("f") / "camera.yaml"
    path.write_text(text.replace("rate: 30 ", f"rate: {RATE:g} "), encoding="utf-8")
    return path


def _readers(folder: str, count: int, seconds: float) -> list[tuple[float, int]]:
    """Rate and losses of each of `count` readers at once."""
    command = child.command("cm.tools.bench.reader", folder, str(seconds))
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "env": child.environment()}
    readers = [subprocess.Popen(command, **pipes, text=True) for _ in range(count)]  # type: ignore[call-overload]
    for reader in readers:
        reader.stdout.readline()  # it has had its first frame
    for reader in readers:
        reader.stdin.write("go\n")
        reader.stdin.flush()
    return [_report(reader) for reader in readers]


def _report(reader: subprocess.Popen[str]) -> tuple[float, int]:
    rate, lost = reader.communicate()[0].split()
    return float(rate), int(lost)
