# SPDX-License-Identifier: Apache-2.0
"""The routes of every day, timed or counted in one tree: a script that any tree's Python runs.

    python routes.py times|counts|instructions [--quick]

It imports nothing of its own tree: `cm` is that of the Python that runs it, used as its users do, so that trees of
different ages can be compared (`cm bench --compare DIR`). What it found is a JSON object on standard output: for each
route (start, read, request, write, status, frame, mode) and figure a number per trip.

Times depend on the machine, counts do not:

- *calls*: calls of functions of the package, of all threads, by `sys.setprofile`. Comprehensions are left out, since
  Python 3.12 has them inline, and so are functions of other packages.
- *system calls*: those of all threads, by strace (``strace -c``).
- *instructions*: those of the manager, in user space, by valgrind's callgrind; another build of Python has others.
"""

from __future__ import annotations

import json
import mmap
import os
import re
import runpy
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import cycle
from pathlib import Path
from types import FrameType
from typing import Any

PATIENCE = 300.0  # seconds; under callgrind a start takes a minute on a busy machine
MODES = ("edge_detection", "default")
INLINE = frozenset(("<listcomp>", "<setcomp>", "<dictcomp>"))
CALLS, MODULES, COMPILED = range(3)  # what a counted manager counts, in this order

Trip = Callable[[], object]


class Counts:
    """Numbers in a file that two processes share: one counts, the other reads."""

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._numbers = memoryview(mmap.mmap(file.fileno(), 24)).cast("Q")

    @classmethod
    def made(cls, path: Path) -> Counts:
        """All of them zero."""
        path.write_bytes(bytes(24))
        return cls(path)

    def __getitem__(self, which: int) -> int:
        return self._numbers[which]

    def start(self) -> None:
        """Count what this process calls from now on."""
        numbers, known = self._numbers, dict[object, bool]()

        def called(frame: FrameType, event: str, _: object) -> None:
            if event != "call":
                return
            code = frame.f_code
            ours = known.get(code)
            if ours is None:
                module = str(frame.f_globals.get("__name__", ""))
                ours = known[code] = module.split(".")[0] == "cm" and code.co_name not in INLINE
            if ours:
                numbers[CALLS] += 1

        threading.setprofile(called)
        sys.setprofile(called)

    def stop(self) -> None:
        """Count no more, in this thread."""
        sys.setprofile(None)

    def watch_imports(self) -> None:
        """Count the package's modules that are imported, and the texts that are compiled meanwhile."""
        numbers = self._numbers

        def heard(event: str, arguments: tuple[Any, ...]) -> None:
            if event == "import" and arguments[0].split(".")[0] == "cm":
                numbers[MODULES] += 1
            elif event == "compile" and not str(arguments[1]).endswith(".py"):  # a module without bytecode is none
                numbers[COMPILED] += 1

        sys.addaudithook(heard)


def serve(counts: Path, *arguments: str) -> None:
    """``cm serve`` in this process, which counts."""
    counting = Counts(counts)
    counting.watch_imports()
    counting.start()
    sys.argv = ["cm", "serve", *arguments]
    runpy.run_module("cm", run_name="__main__", alter_sys=True)


@contextmanager
def manager(folder: Path, *before: str) -> Iterator[tuple[subprocess.Popen[bytes], float]]:
    """A manager on a simulated board, with nothing loaded yet, and the seconds until it said that it is ready.

    `before`: the words of its command line before the options of ``cm serve``.
    """
    import cm

    data = Path(cm.__file__).parent / "data/camera"
    words = [*before, "--sim", "--config", str(data), "--runtime-dir", str(folder), "--state-dir", str(folder / "s")]
    environment = {"CM_SIM_TIMEOUT": "60", **os.environ}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has its bytecode
    start = time.perf_counter()
    process = subprocess.Popen(words, stderr=subprocess.PIPE, env=environment)
    try:
        _await(process.stderr, "ready at")
        yield process, time.perf_counter() - start
    finally:
        process.terminate()
        process.communicate()


def _await(pipe: Any, *words: str) -> None:
    """Read what a child says until it has said all these words."""
    said = ""
    while not all(word in said for word in words):
        ready, _, _ = select.select([pipe], [], [], PATIENCE)
        piece = os.read(pipe.fileno(), 4096) if ready else b""
        if not piece:
            raise SystemExit(f"{words} were not said, but: {said}")
        said += piece.decode(errors="replace")


def trips_of(board: Any, echo: Any) -> dict[str, Trip]:
    """Each route's trip, through the Python client."""
    registers, modes = board.registers, cycle(MODES)

    def write() -> None:
        registers["led"] = 3

    def frame() -> None:
        with echo.slot():
            pass

    return {
        "read": lambda: registers["led"],
        "request": lambda: registers.read("led", "scratch"),  # of one register it may need none
        "write": write,
        "status": lambda: board.status,
        "frame": frame,
        "mode": lambda: board.set_mode(next(modes)),
    }


@contextmanager
def routes(folder: Path) -> Iterator[dict[str, Trip]]:
    """The trips to a manager that has loaded a mode, each made a few times already."""
    import cm

    with cm.connect(str(folder), timeout=PATIENCE) as board:
        board.load("camera", mode=MODES[1])
        with board.echo(1024) as echo:
            trips = trips_of(board, echo)
            for name, trip in trips.items():
                for _ in range(2 if name == "mode" else 20):
                    trip()
            yield trips


def cm_serve() -> list[str]:
    """The words before its options."""
    return [sys.executable, "-m", "cm", "serve"]


def times(folder: Path, quick: bool) -> dict[str, float]:
    """µs per trip, the best of several batches; seconds to the start and MiB of memory."""
    import cm

    with manager(folder, *cm_serve()) as (process, seconds):
        begun = time.perf_counter()
        with cm.connect(str(folder), timeout=PATIENCE) as board:
            _ = board.status
        found = {"start s": seconds, "first status s": seconds + time.perf_counter() - begun}
        with routes(folder) as trips:
            for name, trip in trips.items():
                batches, many = (6 if quick else 12, 1) if name == "mode" else (3 if quick else 30, 50)
                found[f"{name} µs"] = min(_timed(trip, many) for _ in range(batches))
        resident = int(Path(f"/proc/{process.pid}/statm").read_text(encoding="ascii").split()[1])
        found["memory MiB"] = resident * os.sysconf("SC_PAGE_SIZE") / 2**20
    return found


def _timed(trip: Trip, many: int) -> float:
    start = time.perf_counter()
    for _ in range(many):
        trip()
    return (time.perf_counter() - start) / many * 1e6


def counts(folder: Path, quick: bool) -> dict[str, float]:
    """Calls of the manager and the client, and the system calls of both, per trip; at the start, what it imports."""
    import cm

    theirs, ours = Counts.made(folder / "manager"), Counts.made(folder / "client")
    with manager(folder, sys.executable, __file__, "serve", str(folder / "manager")):
        with cm.connect(str(folder), timeout=PATIENCE) as board:
            _ = board.status
        names = ("calls of the manager", "modules", "texts compiled")
        found: dict[str, float] = {f"start, {name}": theirs[number] for number, name in enumerate(names)}
        with routes(folder) as trips:
            for name, trip in trips.items():
                many, batches = (1, 3 if quick else 12) if name == "mode" else (100, 3 if quick else 10)
                pairs = [_counted(trip, many, theirs, ours) for _ in range(batches)]
                found[f"{name}, calls of the manager"] = min(pair[0] for pair in pairs)
                found[f"{name}, calls of the client"] = min(pair[1] for pair in pairs)
    return {**found, **(system_calls(folder / "t", quick) if may_trace() else {})}


def _counted(trip: Trip, many: int, theirs: Counts, ours: Counts) -> tuple[float, float]:
    before = theirs[CALLS], ours[CALLS]
    ours.start()
    try:
        for _ in range(many):
            trip()
    finally:
        ours.stop()
    after = theirs[CALLS], ours[CALLS]
    return (after[0] - before[0]) / many, (after[1] - before[1]) / many


def may_trace() -> bool:
    """Whether strace is here, and may attach to processes that are not its children (Yama's ptrace_scope)."""
    scope = Path("/proc/sys/kernel/yama/ptrace_scope")
    restricted = scope.exists() and scope.read_text(encoding="ascii").strip() != "0"
    return shutil.which("strace") is not None and (os.geteuid() == 0 or not restricted)


def system_calls(folder: Path, quick: bool) -> dict[str, float]:
    """Those of the manager and this client together, per trip."""
    folder.mkdir()
    with manager(folder, *cm_serve()) as (process, _), routes(folder) as trips:
        found = {}
        for name, trip in trips.items():
            if name == "mode":  # its waits are as many as the port's 20 ms give time for
                continue
            many = 100 if quick else 500
            found[f"{name}, system calls"] = min(_traced(process.pid, folder, trip, many) for _ in range(3))
    return found


def _traced(pid: int, folder: Path, trip: Trip, many: int) -> float:
    table = folder / "strace"
    words = ["strace", "-c", "-f", "-U", "calls", "-o", str(table), "-p", str(pid), "-p", str(os.getpid())]
    with subprocess.Popen(words, stderr=subprocess.PIPE) as tracer:
        _await(tracer.stderr, *(f"Process {one} attached" for one in (pid, os.getpid())))
        for _ in range(many):
            trip()
        tracer.send_signal(signal.SIGINT)
        tracer.communicate()
    return int(table.read_text(encoding="ascii").split()[-2]) / many  # "… 6861 total"


def instructions(folder: Path, quick: bool) -> dict[str, float]:
    """Instructions of the manager per trip, by callgrind; nothing where valgrind is not installed."""
    if shutil.which("callgrind_control") is None:
        return {}
    written = folder / "callgrind"
    words = ["valgrind", "--tool=callgrind", "-q", f"--callgrind-out-file={written}", *cm_serve()]
    with manager(folder, *words) as (process, _), routes(folder) as trips:
        found = {}
        for number, (name, trip) in enumerate(trips.items(), 1):
            many = 2 if name == "mode" else 20 if quick else 200
            _control(process.pid, "--zero")
            for _ in range(many):
                trip()
            _control(process.pid, "--dump")
            text = written.with_name(f"callgrind.{number}").read_text(encoding="utf-8", errors="replace")
            match = re.search(r"^(?:totals|summary): (\d+)", text, re.MULTILINE)
            found[f"{name}, instructions of the manager"] = int(match[1]) / many if match else 0
    return found


def _control(pid: int, what: str) -> None:
    subprocess.run(["callgrind_control", what, str(pid)], check=True, capture_output=True)


KINDS: Mapping[str, Callable[[Path, bool], dict[str, float]]] = {
    "times": times,
    "counts": counts,
    "instructions": instructions,
}


def main(words: list[str]) -> int:
    """Measure."""
    sys.path.pop(0)  # our own folder, whose modules nobody means
    kind, *rest = words
    if kind == "serve":
        serve(Path(rest[0]), *rest[1:])
        return 0
    with tempfile.TemporaryDirectory(prefix="cmr", dir="/tmp") as folder:
        found = KINDS[kind](Path(folder), "--quick" in rest)
    print(json.dumps(found))
    return 0


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        sys.exit(main(sys.argv[1:]))
