# SPDX-License-Identifier: Apache-2.0
"""A producer that must not stall, and readers that are killed at random and must leave nothing behind."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from manager_process import REPOSITORY, Manager, environment, until

import cm
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import StreamStatus

READERS = 8
WORDS = 16384  # 128 KiB a frame
DEPTH = 4  # frames that a reader may hold if it does not say
HUNG = 30.0  # seconds; a busy machine may well take some between two frames


@dataclass(frozen=True)
class Outcome:
    """The outcome of a stress run."""

    produced: int
    longest_gap: float  # seconds between two frames that the hardware took
    frames: int
    kills: int


@dataclass(frozen=True)
class Held:
    """What processes hold: descriptors and mappings of slots."""

    manager_fds: int
    manager_maps: int
    board_fds: int
    board_maps: int
    buffers: int
    memory: int


def held(manager: Manager, sim: SimBoard) -> Held:
    """What manager and board hold now."""
    assert manager.process is not None
    state = sim.control.state()
    return Held(*_counts(manager.process.pid), *_counts(sim.pid), state["buffers"], state["memory"])


def _nothing_is_left(manager: Manager, sim: SimBoard, before: Held) -> None:
    """Check that nobody holds more than before; less is possible, as connections of earlier tests end meanwhile."""
    left = {}

    def gone() -> bool:
        now = asdict(held(manager, sim))
        left.clear()
        left.update({key: (value, now[key]) for key, value in asdict(before).items() if now[key] > value})
        return not left

    try:
        until(gone)
    except AssertionError:
        raise AssertionError(f"left behind (before, now): {left}") from None


def _all_is_given_back(board: cm.Board) -> None:
    """Check that dead readers hold no slots: no client is left, there are no surplus slots, and all are in use."""

    def alone() -> StreamStatus | None:
        stream = next(s for s in board.status.streams if s.name == "from_pl")
        return None if stream.clients else stream

    stream = until(alone)
    assert stream.slots <= 2 * READERS * DEPTH, f"{stream.slots} slots for {READERS} readers"
    with board.stream("from_pl", depth=1, timeout=60) as reader, board.writer("to_pl", timeout=60) as writer:
        places = set()
        for number in range(2 * stream.slots):
            writer.write(np.full(WORDS, number, np.uint64))
            frame = reader.read(timeout=60)
            assert (frame == number).all()
            places.add(frame.__array_interface__["data"][0])
            del frame
    assert len(places) >= stream.slots, f"the hardware has {len(places)} of {stream.slots} slots"


def _counts(pid: int) -> tuple[int, int]:
    fds = len(list(Path(f"/proc/{pid}/fd").iterdir()))
    return fds, Path(f"/proc/{pid}/maps").read_text().count("cm-sim-buffer")


def warm(board: cm.Board) -> None:
    """Visit every mode: the manager keeps images that it has loaded, or thinks it will."""
    board.load("camera", "default")
    for mode in board.config("camera").modes:
        board.load("camera", mode.name)
    board.load("camera", "default")


def stress(manager: Manager, sim: SimBoard, seconds: float, seed: int) -> Outcome:
    """Run it on the loop of the camera example. Raises AssertionError for a torn frame, a stall or a leak."""
    with manager.connected() as board:
        warm(board)
        board.load("camera", "loopback")
        until(lambda: not any(stream.open for stream in board.status.streams))
        before = held(manager, sim)
        for name in ("to_pl", "from_pl"):
            board.configure_stream(name, shape=(WORDS,), dtype="uint64", force=True)
        board.configure_stream("from_pl", enable=True)
        outcome = _produce(board, manager, seconds, seed)
        _all_is_given_back(board)
        board.configure_stream("from_pl", automatic=True)
        _nothing_is_left(manager, sim, before)
        board.load("camera", "default")
    return outcome


def _produce(board: cm.Board, manager: Manager, seconds: float, seed: int) -> Outcome:
    script = REPOSITORY / "tests" / "plane_readers.py"
    command = [sys.executable, str(script), str(manager.runtime), "from_pl", str(READERS), str(seconds), str(seed)]
    readers = subprocess.Popen(command, stdout=subprocess.PIPE, env=environment())
    produced, longest = 0, 0.0
    with readers, board.writer("to_pl", timeout=60) as writer:
        last = time.monotonic()
        while readers.poll() is None:
            writer.write(np.full(WORDS, produced, np.uint64))
            writer.flush()
            now = time.monotonic()
            longest, last = max(longest, now - last), now
            produced += 1
        assert readers.stdout is not None
        told = json.loads(readers.stdout.read())
    assert readers.returncode == 0, told
    assert told["wrong"] == 0
    return Outcome(produced, longest, told["frames"], told["kills"])
