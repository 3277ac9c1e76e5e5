# SPDX-License-Identifier: Apache-2.0
"""What a flight recorder costs: the manager, itself and other clients, and how fast it writes whole frames."""

from __future__ import annotations

import os
import signal
import statistics
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import foxglove
import numpy as np
from foxglove.mcap import MCAPWriteOptions

from cm import child
from cm.client.board import Board
from cm.errors import CmError
from cm.recording import pictures
from cm.recording.layout import Opened
from cm.recording.record import Limits, Record
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Plan, Samples, interleave
from cm.tools.bench.run import IMAGE, Run
from cm.tools.bench.serving import PATIENCE, Served, cpu_seconds, environment, serve, settle
from cm.wire.messages.status import FrameInfo

WRITES = 50  # a second, of a register, by another client
SHARED = Path("/dev/shm")  # memory: what a page cache takes, without the disk behind it
MANAGER = (
    "processor time of cm serve while a client writes a register fifty times a second and another reads 30 frames of "
    "640×480 a second, with cm record of all of that, less the same without it; percent of one CPU, medians of rounds "
    "in turns"
)
RECORDER = "processor time of cm record meanwhile; percent of one CPU"
P99 = "99th percentile of those writes with cm record, per that without it, medians of rounds in turns"
FRAMES = (
    "frames of 3.96 MiB, from memory into a record, per second; baseline: the faster of foxglove-sdk and mcap with the "
    "same bytes and nothing else, in turns; ratio: speed of the record per that"
)


def run(bench: Run) -> list[Result]:
    """Measure the results that are named."""
    results = _beside_a_manager(bench)
    results.append(_frames(bench, "record_frames", SHARED if SHARED.is_dir() else bench.folder))
    results.append(_frames(bench, "record_frames_disk", bench.folder, ", until the disk has them", sync=True))
    return results


# ---- beside a manager -------------------------------------------------------------------------


def _beside_a_manager(bench: Run) -> list[Result]:
    rounds, seconds = (1, 1.0) if bench.quick else (7, 4.0)
    manager: dict[bool, list[float]] = {False: [], True: []}
    p99: dict[bool, list[float]] = {False: [], True: []}
    recorder: list[float] = []
    with serve(bench) as served, served.connect() as board:
        settle(board)  # before that no mode has streams
        with _reading(served):
            _write(board, 0.5)
            for _ in range(rounds):
                manager[False].append(_percent(served.pid, lambda: p99[False].append(_write(board, seconds))))
                with _recording(bench, served) as pid:
                    before, started = cpu_seconds(pid), time.monotonic()
                    manager[True].append(_percent(served.pid, lambda: p99[True].append(_write(board, seconds))))
                    recorder.append(100 * (cpu_seconds(pid) - before) / (time.monotonic() - started))
    more = statistics.median(manager[True]) - statistics.median(manager[False])
    without, beside = statistics.median(p99[False]), statistics.median(p99[True])
    details = {"percent_with": manager[True], "percent_without": manager[False]}
    return [
        Result("record_manager", more, "% of a CPU", MANAGER, goal=Goal(1.0), details=details),
        Result("record_recorder", statistics.median(recorder), "% of a CPU", RECORDER, goal=Goal(5.0)),
        Result(
            "record_p99", beside * 1e6, "µs", P99, without * 1e6, beside / without, Goal(1.1), details={
                "with_us": [value * 1e6 for value in p99[True]], "without_us": [value * 1e6 for value in p99[False]]
            },
        ),
    ]  # fmt: skip


def _percent(pid: int, work: Callable[[], object]) -> float:
    before, started = cpu_seconds(pid), time.monotonic()
    work()
    return 100 * (cpu_seconds(pid) - before) / (time.monotonic() - started)


def _write(board: Board, seconds: float) -> float:
    """Write for so long; the 99th percentile of a write, in seconds."""
    took: list[float] = []
    end = due = time.monotonic() + seconds
    due -= seconds
    while due < end:
        began = time.monotonic()
        board.registers["focus"] = len(took) & 7
        took.append(time.monotonic() - began)
        due += 1 / WRITES
        time.sleep(max(0.0, due - time.monotonic()))
    return Samples((tuple(took),)).p99


@contextmanager
def _reading(served: Served) -> Iterator[None]:
    """Another reader of the camera, so that it runs with and without a recorder."""
    over = threading.Event()

    def read() -> None:
        with served.connect() as board, board.stream("camera", timeout=PATIENCE) as stream, suppress(CmError):
            while not over.is_set():
                stream.read().release()

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def _recording(bench: Run, served: Served) -> Iterator[int]:
    """``cm record`` of everything; its process id, once it has been at work for a second."""
    path = bench.place("r") / "all.mcap"
    words = child.command("cm", "record", str(path), "--streams", "all", "--runtime-dir", str(served.runtime_dir))
    process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment(bench))
    try:
        deadline = time.monotonic() + PATIENCE
        while not (path.exists() and path.stat().st_size > 1 << 20):
            if process.poll() is not None or time.monotonic() > deadline:
                raise CmError(f"cm record does not record (status {process.returncode})")
            time.sleep(0.05)
        yield process.pid
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()
        for file in path.parent.glob("*.mcap"):
            file.unlink()


# ---- whole frames -----------------------------------------------------------------------------


class _Sdk:
    """foxglove-sdk alone, as it is fastest: no compression."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._context = context = foxglove.Context()  # its channels end with it
        schema = foxglove.Schema(name="x", encoding="protobuf", data=b"")
        self._channel = foxglove.Channel("x", message_encoding="protobuf", schema=schema, context=context)
        options = MCAPWriteOptions(compression=None)
        self._writer = foxglove.open_mcap(path, context=context, writer_options=options)

    def write(self, data: bytes) -> None:
        self._channel.log(data, log_time=time.time_ns())

    def close(self) -> None:
        self._writer.close()
        self._path.unlink()


class _Mcap:
    """mcap alone, as it is fastest: without chunks."""

    def __init__(self, path: Path) -> None:
        from mcap.writer import CompressionType, Writer

        self._path = path
        self._writer: Any = Writer(str(path), compression=CompressionType.NONE, use_chunking=False)
        self._writer.start()
        self._channel = self._writer.register_channel(
            "x", "protobuf", self._writer.register_schema("x", "protobuf", b"")
        )

    def write(self, data: bytes) -> None:
        now = time.time_ns()
        self._writer.add_message(self._channel, now, data, now)

    def close(self) -> None:
        self._writer.finish()
        self._path.unlink()


class _Ours:
    """A record, as the recorder writes frames: heads are made each time, bytes are written from where they lie."""

    def __init__(self, path: Path) -> None:
        self._path = path
        opened = Opened("bench", 0, 0, 0, "", 0, "")
        self._record = Record(path, Limits(), opened, time.time_ns, lambda _: ())
        self._image = np.zeros(IMAGE, np.uint8)
        self._due = time.monotonic() + 1

    def write(self, data: bytes) -> None:
        now = time.time_ns()
        info = FrameInfo("camera", 1, now, IMAGE, (1080, 1920 * 2), "uint8")
        head = pictures.head_of(info, IMAGE, now)
        self._record.log(self._record.channels.of("cm_stream/camera", pictures.SCHEMA), (head.data, data), now)
        if time.monotonic() > self._due:
            self._due += 1
            self._record.tick()

    def close(self) -> None:
        self._record.close()
        self._path.unlink()


def _frames(bench: Run, name: str, folder: Path, where: str = ", in memory", sync: bool = False) -> Result:
    """Each contestant writes a file of its own in each round, which is then removed."""
    plan = Plan(1, 3, 1) if bench.quick else Plan(12, 40, 1)
    path = folder / f"cm-bench-{os.getpid()}.mcap"
    data = np.random.default_rng(1).integers(0, 256, IMAGE, np.uint8).tobytes()

    def batch(kind: Callable[[Path], Any]) -> Callable[[int], tuple[float, ...]]:
        def write(count: int) -> tuple[float, ...]:
            writer = kind(path)
            began = time.monotonic()
            for _ in range(count):
                writer.write(data)
            if sync:
                with path.open("rb") as file:
                    os.fdatasync(file.fileno())
            took = (time.monotonic() - began) / count
            writer.close()
            return (took,)

        return write

    found = interleave({kind.__name__: batch(kind) for kind in (_Ours, _Sdk, _Mcap)}, plan)
    seconds = {kind: samples.median for kind, samples in found.items()}
    fastest = min(("_Sdk", "_Mcap"), key=seconds.__getitem__)
    details = {kind.strip("_").lower(): 1 / value for kind, value in seconds.items()}
    ratio = found[fastest].over(found["_Ours"])
    goal = Goal(0.95, at_least=True)
    rate, baseline = 1 / seconds["_Ours"], 1 / seconds[fastest]
    return Result(name, rate, "frames/s", FRAMES + where, baseline, ratio, goal, details=details)
