# SPDX-License-Identifier: Apache-2.0
"""Recorders that are killed, and disks that are full: what was recorded by then is there, for every reader."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from manager_process import Manager, environment, served, until

from cm import child
from cm.cli.main import main
from cm.recording.layout import CLOCK, FRAME_PREFIX, GAP, REGISTERS, STREAM_PREFIX, files_of
from cm.recording.reader import Record

mcap_reader = pytest.importorskip("mcap.reader", reason="records need mcap")
small_mcap = pytest.importorskip("small_mcap", reason="reads records, by others")

CAMERA = ("--streams", "camera")
FULL = """
mount -t tmpfs -o size=80m none "$1" && head -c 67108864 /dev/zero >"$1/filler" || exit 1
shift
"$@" &
echo $!
wait
read -r _
"""


class Writer:
    """Writes a register as fast as it may. `told`: of each reply when it came (CLOCK_MONOTONIC), and its generation."""

    def __init__(self, manager: Manager) -> None:
        self.told: list[tuple[int, int]] = []
        self._manager, self._over = manager, threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        with self._manager.connected() as board:
            while not self._over.wait(0.01):
                generation = board.registers.write({"focus": len(self.told) & 7}).generation
                self.told.append((time.monotonic_ns(), generation))

    def __enter__(self) -> Writer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()


def recorder(manager: Manager, *words: str, before: tuple[str, ...] = (), **pipes: Any) -> subprocess.Popen[bytes]:
    command = child.command("cm.cli.main", "record", *words, "--runtime-dir", str(manager.runtime))
    return subprocess.Popen([*before, *command], env=environment(), **pipes)


def strictly_read(path: Path) -> int:
    """Messages of a file, as three readers of others have it, all CRCs checked."""
    with path.open("rb") as file:
        count = sum(1 for _ in mcap_reader.make_reader(file, validate_crcs=True).iter_messages())
    with path.open("rb") as file:
        assert sum(1 for _ in small_mcap.read_message(file, validate_crc=True)) == count
    if doctor := shutil.which("pymcap-cli", path=str(Path(sys.executable).parent)):
        subprocess.run([doctor, "doctor", str(path)], check=True, capture_output=True)
    return count


def is_whole_but_for_the_last_second(path: Path, told: list[tuple[int, int]]) -> int:
    """Nothing is missing from a second before the recorder's last tick; the time of its last message (monotonic)."""
    record = Record(path)
    events = list(record.events(lambda topic: not topic.startswith(STREAM_PREFIX)))
    offset = record.opened.offset_ns
    begun, ticked = (pick(e.time_ns for e in events if e.topic == CLOCK) - offset for pick in (min, max))
    there = [e.value.generation for e in events if e.topic == REGISTERS and e.value.generation]
    assert there == sorted(set(there))
    assert not there or there == list(range(there[0], there[-1] + 1))
    wanted = {generation for at, generation in told if begun <= at <= ticked - 10**9}
    assert wanted <= set(there), sorted(wanted - set(there))
    frames = [e.value.frame.sequence for e in events if e.topic.startswith(FRAME_PREFIX)]
    assert frames == sorted(set(frames))
    return max(e.time_ns for e in events) - offset


def killed(manager: Manager, path: Path, seconds: float) -> tuple[float, float, int]:
    """A recorder is killed so long after it began: how many seconds before that its last message, its last tick are."""
    with Writer(manager) as writer:
        process = recorder(manager, str(path), *CAMERA, "--frames", "every", "3", stderr=subprocess.DEVNULL)
        until(lambda: path.exists() and path.stat().st_size > 0)
        time.sleep(seconds)  # any instant will do
        process.send_signal(signal.SIGKILL)
        process.wait()
        end = time.monotonic_ns()
    if path.stat().st_size < 1 << 15:  # before its first chunk
        return 0.0, 0.0, 0
    last = is_whole_but_for_the_last_second(path, writer.told)
    acknowledged = [at for at, _ in writer.told if at <= end]
    good = path.with_name(f"{path.stem}-good.mcap")
    assert main(["record", "repair", str(path), str(good)]) == 0
    assert main(["why", str(path)]) == 0
    return (end - last) / 1e9, (end - acknowledged[-1]) / 1e9, strictly_read(good)


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    with served() as (made, _):
        with made.connected() as board:
            board.load("camera", "default")
        yield made


@pytest.mark.timeout(7200)
def test_a_recorder_that_is_killed_at_any_instant_leaves_a_record(
    manager: Manager, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    draw, read = random.Random(58), 0
    for number in range(request.config.getoption("--rounds")):
        path = tmp_path / f"{number}.mcap"
        read += killed(manager, path, draw.uniform(0.0, 3.0))[2]
        for left in tmp_path.glob("*.mcap"):
            left.unlink()
    assert read


@contextlib.contextmanager
def on_a_small_disk(manager: Manager, place: Path, *words: str) -> Iterator[tuple[subprocess.Popen[bytes], Path, int]]:
    """A recorder on a file system of 80 MiB, 64 of which are taken; the place as it is seen from outside; its pid."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    before = ("unshare", "--mount", "sh", "-c", FULL, "sh", str(place))
    with recorder(manager, *words, before=before, **pipes) as process:
        assert process.stdout is not None
        pid = process.stdout.readline().strip()
        if not pid:
            assert process.stderr is not None
            pytest.skip(f"may mount nothing: {process.stderr.read().decode()}")
        try:
            yield process, Path(f"/proc/{process.pid}/root{place}"), int(pid)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(pid), signal.SIGKILL)


@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("unshare") is None, reason="needs root, and unshare")
@pytest.mark.timeout(600)
def test_a_full_disk_is_a_gap_as_long_as_what_is_missing(manager: Manager, tmp_path: Path) -> None:
    place = tmp_path / "disk"
    place.mkdir()
    with on_a_small_disk(manager, place, str(place / "full.mcap"), *CAMERA) as (process, seen, pid):
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line.decode())
            if "No space left" in said[-1]:
                first = (seen / "full.mcap").stat().st_size
                assert strictly_read(seen / "full.mcap")  # a strict reader takes it as it is
                (seen / "filler").unlink()
            if "there is room again" in said[-1]:
                break
        until(lambda: len(files_of(seen / "full.mcap")) == 2)
        os.kill(pid, signal.SIGTERM)
        until(lambda: not Path(f"/proc/{pid}").exists())
        files = files_of(seen / "full.mcap")
        assert [strictly_read(file) > 0 for file in files] == [True, True]
        record = Record(seen / "full.mcap")
        events = list(record.events(lambda topic: topic.startswith(FRAME_PREFIX)))
        assert record.problems == []
        assert main(["why", str(seen / "full.mcap")]) == 0
    assert 8 << 20 < first < 16 << 20
    (gap,) = [e.value for e in events if e.topic == GAP]
    assert gap.cause == "disk_full"
    frames = [e.value.frame.sequence for e in events if e.topic.startswith(FRAME_PREFIX)]
    missing = sum(b - a - 1 for a, b in itertools.pairwise(frames))
    assert 0 < 2 * missing <= gap.messages  # a frame is told of, and has its data
    assert gap.bytes > missing * 640 * 480
    assert gap.from_ns < gap.until_ns
