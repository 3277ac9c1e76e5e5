#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A control loop at 10 kHz over mapped registers, while the mode changes under it.

    cm serve --sim & cm status --wait; python examples/control_loop.py --seconds 5

Each turn reads two registers of the module `edge`, its identity and `threshold`, and writes one, `focus`. Another
connection changes the mode ten times, to a mode without that module and back. The manager takes the registers away
before each change; the loop waits until the module is back. It never reads another module's register, which is what
the identity is for. With `--reads N` it then reads the identity N times, as fast as it can, under further changes.

On a simulated board a write is a round trip to the simulator, which has to see it, so the loop runs as fast as that
(`--no-write` leaves it out); on a board it is a store.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import cm

EDGE = 0xCA3E0002  # what the identity register reads while the region holds `edge`
RATE = 10_000  # turns a second
BEHIND = 0.01  # seconds behind from which the loop begins to count anew instead of hurrying
MODES = ("default", "edge_detection")


@contextmanager
def changing(runtime_dir: str | None, changes: int, pause: float) -> Iterator[None]:
    """Change the mode so often meanwhile, from a connection of its own; it is the same at the end as before."""
    over = threading.Event()

    def change() -> None:
        with cm.connect(runtime_dir=runtime_dir, timeout=60) as board:
            for number in range(changes):
                if number % 2 == 0 and over.wait(pause):
                    break
                board.mode = MODES[number % 2]
            board.mode = MODES[1]

    thread = threading.Thread(target=change)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def control(board: cm.Board, seconds: float, writes: bool) -> tuple[int, int, float]:
    """Turns at the rate for so long.

    Returns how many there were, how many read another module's identity, and seconds without a turn: while the module
    was away, or somebody else had the processor.
    """
    turns, wrong, away = 0, 0, 0.0
    with board.registers.window("edge", wait=True) as regs:
        due = time.monotonic()
        end = due + seconds
        while due < end:
            identity, threshold = regs.ident, regs.threshold
            if writes:
                regs.focus = threshold + turns % 2
            turns += 1
            wrong += identity != EDGE
            due += 1 / RATE
            left = due - time.monotonic()
            if left > 0:
                time.sleep(left)
            elif left < -BEHIND:
                away -= left
                due -= left
    return turns, wrong, away


def read(board: cm.Board, count: int) -> int:
    """Read the identity so often; returns how often it was another module's."""
    with board.registers.window("edge", write=False, wait=True) as regs:
        return sum(regs.ident != EDGE for _ in range(count))


def main() -> int:
    """Run it; the exit status is 1 if another module's register was read."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runtime-dir", default=None, metavar="DIR")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--changes", type=int, default=10, help="changes of mode while it runs (default: 10)")
    parser.add_argument("--reads", type=int, default=0, help="reads of the identity afterwards")
    parser.add_argument("--no-write", action="store_true", help="read only")
    args = parser.parse_args()
    with cm.connect(runtime_dir=args.runtime_dir, timeout=60) as board:
        board.mode = MODES[1]
        used, began = time.thread_time(), time.monotonic()
        with changing(args.runtime_dir, args.changes, 2 * args.seconds / (args.changes + 2)):
            turns, wrong, away = control(board, args.seconds, not args.no_write)
            used, took = time.thread_time() - used, time.monotonic() - began
        print(
            f"{turns / (took - away):.0f} turns a second with {used / took:.0%} of a processor, "
            f"in {took:.1f} s of which the module was away for {away:.2f}"
        )
        if args.reads:
            with changing(args.runtime_dir, 1_000_000, 0.1):
                wrong += read(board, args.reads)
        print(f"{2 * turns + args.reads} reads, {wrong} of another module")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
