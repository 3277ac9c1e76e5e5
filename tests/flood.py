# SPDX-License-Identifier: Apache-2.0
"""Clients that ask a lot, as processes of their own: how many of what is bounded, and all of it on this machine."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

# Connects so often, says how many of them were not hung up on, and holds them until its input ends.
_IDLE = """
import select, socket, sys
family, count = sys.argv[1], int(sys.argv[2])
held = []
for _ in range(count):
    made = socket.socket(socket.AF_UNIX if family == "unix" else socket.AF_INET)
    made.connect(sys.argv[3] if family == "unix" else (sys.argv[3], int(sys.argv[4])))
    made.settimeout(60)  # not before: connect() would not wait for its turn
    held.append(made)
kept = 0
for made in held:
    try:
        kept += made.recv(1) == b"\\xff"  # a listener that keeps it greets
    except ConnectionError:
        pass
print(kept, flush=True)
sys.stdin.read()
"""


@contextlib.contextmanager
def idle_connections(where: Path | tuple[str, int], count: int, processes: int) -> Iterator[list[int]]:
    """`count` connections of each of so many processes; how many of each were kept."""
    place = ["unix", str(count), str(where)] if isinstance(where, Path) else ["inet", str(count), *map(str, where)]
    command = [sys.executable, "-S", "-E", "-c", _IDLE, *place]
    made = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) for _ in range(processes)]
    try:
        yield [int(process.stdout.readline()) for process in made if process.stdout]
    finally:
        for process in made:
            process.communicate()
            process.wait()


def descriptors(pid: int) -> int:
    """How many a process has."""
    return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())


def watched_processes(pid: int) -> int:
    """How many pidfds a process has: unlike sockets, which close when the other side's threads come to it."""
    return sum("[pidfd]" in _link(link) for link in Path(f"/proc/{pid}/fd").iterdir())


def _link(path: Path) -> str:
    try:
        return str(path.readlink())
    except FileNotFoundError:  # it was closed meanwhile
        return ""


def resident_mib(pid: int) -> float:
    """Its memory."""
    for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise AssertionError(f"process {pid} is gone")
