# SPDX-License-Identifier: Apache-2.0
"""Clients that send many requests, as separate processes: bounded in number, and on this machine only."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from manager_process import environment

# Opens connections, says how many of them were not closed, and holds them until its input ends.
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
    """`count` connections of each of several processes; yields how many each one kept."""
    place = ["unix", str(count), str(where)] if isinstance(where, Path) else ["inet", str(count), *map(str, where)]
    command = [sys.executable, "-S", "-E", "-c", _IDLE, *place]
    made = [subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) for _ in range(processes)]
    try:
        yield [int(process.stdout.readline()) for process in made if process.stdout]
    finally:
        for process in made:
            process.communicate()
            process.wait()


# Requests the configuration, which must have some 15 KiB, over its connections, and reads when it is told to.
_UNREAD = """
import sys
import zmq
from cm.wire.messages.requests import ReadConfig
from cm.wire.encode import encode_request
runtime, connections, each = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
ask = encode_request(ReadConfig())
context = zmq.Context()
context.set(zmq.MAX_SOCKETS, 4096)
made = [context.socket(zmq.DEALER) for _ in range(connections)]
for one in made:
    one.linger = 0
    one.sndhwm, one.rcvhwm, one.rcvbuf = 0, 1, 4096
    one.connect(f"ipc://{runtime}/req")
for _ in range(each):
    for one in made:
        one.send_multipart(ask)
print("asked", flush=True)
sys.stdin.readline()
poller, read, whole = zmq.Poller(), 0, 0
for one in made:
    poller.register(one, zmq.POLLIN)
while read < connections * each and (ready := poller.poll(60_000)):
    read += len(ready)
    whole += sum([10 << 10 < len(one.recv_multipart()[-1]) < 16 << 10 for one, _ in ready])
print(read, whole, flush=True)
"""


@contextlib.contextmanager
def running(*words: object, first: str) -> Iterator[subprocess.Popen[str]]:
    """Run Python with these arguments, from its first line of output until the block ends."""
    command = [sys.executable, *map(str, words)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, env=environment(), **pipes) as process:  # type: ignore[call-overload]
        try:
            assert process.stdout.readline() == first + "\n"
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def unread_replies(runtime: Path, connections: int, each: int) -> Iterator[subprocess.Popen[str]]:
    """A process that requests the configuration, of 15 KiB, `each` times over each connection, and reads no reply.

    When it gets a line on its input, it reads them and prints how many came, and how many of those were not refusals.
    """
    with running("-c", _UNREAD, runtime, connections, each, first="asked") as process:
        yield process


def descriptors(pid: int) -> int:
    """How many descriptors a process has."""
    return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())


def resident_mib(pid: int) -> float:
    """The resident memory of a process."""
    for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise AssertionError(f"process {pid} is gone")
