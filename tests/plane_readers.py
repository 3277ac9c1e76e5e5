# SPDX-License-Identifier: Apache-2.0
"""Readers that are killed and started at random. A program: plane_readers.py RUNTIME STREAM READERS SECONDS SEED.

Every frame holds its number in each of its 64-bit words. A reader that sees anything else, a number that
does not grow, or a frame that changes while it is held, ends with status 3. Prints one line of JSON.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import sys
import time
from collections import deque
from pathlib import Path

import numpy as np

from cm.client.stream import LocalStream
from cm.wire.plane_packets import Open

TORN = 3
FRAMES, KILLS = 100, 20  # at least this many, however long it takes


def number_of(frame: np.ndarray) -> int:
    """The number in all words of a frame; leaves the process if they differ."""
    words = np.asarray(frame).reshape(-1).view(np.uint64)
    if not (words == words[0]).all():
        print(f"a torn frame: {np.unique(words)[:5]}", file=sys.stderr, flush=True)
        os._exit(TORN)
    return int(words[0])


def read(runtime: Path, name: str, seed: int, report: int) -> None:
    """Read for ever, holding some frames for a while."""
    chance = random.Random(seed)
    held: deque[tuple[np.ndarray, int]] = deque()
    last = -1
    with LocalStream(runtime, Open(name), 60.0) as stream:
        for frame in stream:
            number = number_of(frame)
            if number <= last:
                os._exit(TORN)
            last = number
            os.write(report, b".")
            held.append((frame, number))
            del frame
            while len(held) > chance.randrange(4):
                old, was = held.popleft()
                if number_of(old) != was:
                    os._exit(TORN)
                del old


def start(runtime: Path, name: str, seed: int, report: int) -> int:
    """Fork a reader."""
    pid = os.fork()
    if pid == 0:
        try:
            read(runtime, name, seed, report)
        finally:
            os._exit(1)
    return pid


def main(runtime: Path, name: str, readers: int, seconds: float, seed: int) -> int:
    """Kill and start; 0 if all readers died by our hand."""
    chance = random.Random(seed)
    seeds = iter(range(seed, 1 << 30))
    receive, report = os.pipe()
    os.set_blocking(receive, False)
    running = [start(runtime, name, next(seeds), report) for _ in range(readers)]
    frames, kills, wrong = 0, 0, 0
    until = time.monotonic() + seconds
    while time.monotonic() < until or frames <= FRAMES or kills <= KILLS:  # a busy machine takes longer
        time.sleep(chance.uniform(0.0, 0.05))
        with contextlib.suppress(BlockingIOError):
            frames += len(os.read(receive, 1 << 20))
        index = chance.randrange(readers)
        os.kill(running[index], signal.SIGKILL)
        wrong += _status(running[index])
        kills += 1
        running[index] = start(runtime, name, next(seeds), report)
    for pid in running:
        os.kill(pid, signal.SIGKILL)
        wrong += _status(pid)
    print(json.dumps({"frames": frames, "kills": kills, "wrong": wrong}))
    return 1 if wrong else 0


def _status(pid: int) -> int:
    status = os.waitpid(pid, 0)[1]
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL:
        return 0
    print(f"a reader ended with {status}", file=sys.stderr, flush=True)
    return 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5])))
