# SPDX-License-Identifier: Apache-2.0
"""The paper's experiment with ROS 2: images to the accelerator and back, and what the bridge adds."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from cm import child
from cm.client.board import Board
from cm.errors import CmError
from cm.tools.bench.peer import Peer, Unavailable, load
from cm.tools.bench.pl_loop import WrongFrame, serving
from cm.tools.bench.result import Goal, Result, unavailable
from cm.tools.bench.rounds import Batch, Samples, interleave
from cm.tools.bench.run import IMAGES, Run
from cm.tools.bench.serving import PATIENCE, settle

GOALS = {"ros2_publish": Goal(1.1), "ros2_trip": None}
RAN = {
    "ros2_publish": (
        "sensor_msgs/Image of 3.96 MiB one way, from a DMA slot of the simulated board to a subscriber in another "
        "process, by the publisher of cm bridge ros; baseline: a plain publisher in Python over the same zenoh, of the "
        "same slots"
    ),
    "ros2_trip": (
        "1000 sensor_msgs/Image of each of three sizes from a subscriber in another process to the simulated "
        "accelerator and back, through cm bridge ros; baseline: a plain echo in Python over the same zenoh, with no "
        "board"
    ),
}


def run(bench: Run) -> list[Result]:
    """Measure `ros2_*`."""
    try:
        load("zenoh_pictures")
    except Unavailable as why:
        return [unavailable(name, "µs", ran, str(why), GOALS[name]) for name, ran in RAN.items()]
    sizes = sorted(IMAGES)[1:2] if bench.quick else sorted(IMAGES)
    one_way = {size: _one_way(bench, size) for size in sizes}
    trips = {size: _trips(bench, size) for size in sizes}
    return [_result("ros2_publish", one_way), _result("ros2_trip", trips)]


def _result(name: str, found: dict[int, dict[str, Samples]]) -> Result:
    """The result for the middle image; the others are in the details."""
    middle = sorted(found)[len(found) // 2]
    ours, plain = found[middle]["ours"], found[middle]["plain"]
    series = [
        {"bytes": size, "ours": s["ours"].plain(), "plain": s["plain"].plain(), "ratio": s["ours"].over(s["plain"])}
        for size, s in found.items()
    ]
    return Result(
        name, ours.median, "µs", RAN[name], plain.median, ours.over(plain), GOALS[name], details={"sizes": series}
    )


# ---- one way ------------------------------------------------------------------------------


def _one_way(bench: Run, size: int) -> dict[str, Samples]:
    with ExitStack() as stack:
        peer = stack.enter_context(Peer("zenoh_pictures", bench.place("z"), size))
        board = stack.enter_context(stack.enter_context(serving(bench, size)).connect())
        settle(board)
        writer = stack.enter_context(board.writer("to_pl", PATIENCE, depth=1))
        reader = stack.enter_context(board.stream("from_pl", timeout=PATIENCE, depth=1))
        with writer.slot() as slot:
            slot[...] = np.random.default_rng(1).integers(0, 256, slot.shape, np.uint8)
        reader.read().release()
        near: Any = peer.near

        def batch(publish: Any) -> Batch:
            def trips(count: int) -> tuple[float, ...]:
                found = []
                for _ in range(count):
                    with writer.slot():
                        pass  # the slot's content is sent again: the frame that arrives was written just now
                    frame = reader.read()
                    found.append(publish(frame))
                    frame.release()
                return tuple(found)

            return trips

        return interleave({"ours": batch(near.ours), "plain": batch(near.plain)}, bench.plan(50))


# ---- there and back -----------------------------------------------------------------------


def _trips(bench: Run, size: int) -> dict[str, Samples]:
    from cm.tools.bench.peers import zenoh_pictures as pictures

    with ExitStack() as stack:
        near: Any = stack.enter_context(Peer("zenoh_pictures", bench.place("z"), size)).near
        served = stack.enter_context(serving(bench, size, picture=True))
        stack.enter_context(_bridging(served.runtime_dir, near.router))
        ways = {"plain": (pictures.THERE, pictures.BACK), "ours": ("/cm/to_pl/write", "/cm/from_pl/image_raw")}
        trips = {
            name: _Trip(size, pictures.Plain(near.session, there), pictures.Incoming(near.session, back))
            for name, (there, back) in ways.items()
        }
        _await_stream(stack.enter_context(served.connect()))
        for trip in trips.values():
            trip.warm()
        return interleave({name: trip.batch for name, trip in trips.items()}, bench.plan(50))


@contextmanager
def _bridging(runtime: Any, router: str) -> Iterator[None]:
    """`cm bridge ros`, ready."""
    words = child.command("cm.cli.main", "bridge", "ros", "--runtime-dir", str(runtime), "--write", "frames")
    env = child.environment() | {"ROS_DOMAIN_ID": "0"}
    process = subprocess.Popen([*words, "--router", router], stderr=subprocess.PIPE, env=env)
    assert process.stderr is not None
    try:
        while b"cm bridge: /" not in (line := process.stderr.readline()):
            if not line:
                raise CmError("cm bridge ros did not start")
        yield
    finally:
        process.terminate()
        process.communicate()


class _Trip:
    """Pictures there and back; all differ, and each has to come back unchanged."""

    def __init__(self, size: int, plain: Any, incoming: Any) -> None:
        self._plain = plain
        self._incoming = incoming
        self._pixels = np.random.default_rng(2).integers(0, 256, size, np.uint8)

    def warm(self) -> None:
        """One side may know us before the other does, and what is sent before both do is lost."""
        self.batch(1)

    def batch(self, count: int) -> tuple[float, ...]:
        """Durations in µs; what the network does not take is lost, and sent again. Raises WrongFrame."""
        return tuple(self._trip() for _ in range(count))

    def _trip(self) -> float:
        for _ in range(int(PATIENCE)):
            began = time.monotonic_ns()
            if self._sent_and_taken(1.0):
                return (time.monotonic_ns() - began) / 1e3
        raise WrongFrame("the picture that was sent did not come back over zenoh")

    def _sent_and_taken(self, seconds: float) -> bool:
        """Whether a new picture came back; late ones of earlier trips are skipped."""
        self._pixels[:8] = np.frombuffer(os.urandom(8), np.uint8)
        mark, until = self._pixels[:8].tobytes(), time.monotonic() + seconds
        self._plain.write(self._pixels, time.time_ns())
        while (left := until - time.monotonic()) > 0:
            came = self._incoming.take(left)
            if came is not None and came[1].find(mark, 0, 256) >= 0:
                return True
        return False


def _await_stream(board: Board) -> None:
    """Wait for the bridge, which reads a stream only once it has seen its subscriber."""
    end = time.monotonic() + PATIENCE
    while not next(stream for stream in board.status.streams if stream.name == "from_pl").open:
        if time.monotonic() > end:
            raise CmError("the bridge does not read the stream that is subscribed to")
        time.sleep(0.01)
