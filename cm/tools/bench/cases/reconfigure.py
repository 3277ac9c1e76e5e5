# SPDX-License-Identifier: Apache-2.0
"""From the request for a mode to the running module, split into its parts."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from cm.device import Icap, Root
from cm.formats.bitstream.geometry import geometry_of
from cm.formats.bitstream.simulated_module import assemble_module
from cm.manager.execution.worker import Change
from cm.manager.manager import Environment, Manager, Settings
from cm.manager.state.journal import Journal
from cm.schema import load
from cm.schema.model import Config, FrameRange
from cm.server.bitstream_and_overlay_files import BoardFiles
from cm.server.devices import BoardDevices
from cm.simulation.software.process.child import Board
from cm.tools.bench.c_programs import TimedPort
from cm.tools.bench.peer import Unavailable
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run
from cm.wire.messages.requests import ChangeMode
from cm.wire.messages.status import Irq, RegValues

BYTES = 8_000_000
RATE = 400e6  # bytes per second: 32 bits at 100 MHz
SHARE = Goal(0.01)
TRIGGER = Goal(7.0)
PARTS = {
    "validate": "validate",
    "load": "transfer",
    "overlay_remove": "overlay",
    "overlay_apply": "overlay",
    "registers": "registers",
}
RAN = (
    "manager (in this process) and simulated board with an ICAP of 400 MB/s: change of mode that loads a partial "
    "bitstream of 8 MB, exchanges an overlay and writes a register; the image was prefetched. The transfer's own time "
    "is 8 MB / 400 MB/s; ratio: what software adds to the load, per transfer time"
)
_DEVICE = "xc7z100"  # the smallest with room for that many bytes
_SCHEMA = """
config:
  name: bench
  type: partial
  device: xc7z100
  regions:
    prr0:
      loader: icap
      decoupler: {base_address: 0x1000, offset: 0x0, bit: 0}
      identity: {base_address: 0x2000, offset: 0x1000}
  modules:
    one: {region: prr0, identity: 0x1}
    two: {region: prr0, identity: 0x2}
  modes:
    one:
      modules: [one]
      overlay: [first]
      mmio: [{base_address: 0x2000, registers: {gain: {offset: 0x1010, default: 1}}}]
    two:
      modules: [two]
      overlay: [second]
      mmio: [{base_address: 0x2000, registers: {gain: {offset: 0x1010, default: 2}}}]
"""


def _footprint() -> tuple[FrameRange, ...]:
    """All of the device's logic, from its first row on."""
    geometry = geometry_of(_DEVICE)
    assert geometry is not None
    rows = [(number, row) for number in range(64) if (row := geometry.row(0, number)) is not None]
    return tuple([FrameRange(0, number, 0, row.columns - 1) for number, row in rows])


class _Clock:
    def monotonic(self) -> float:
        return time.monotonic()


class _NoStreams:
    def quiesce(self, streams: Collection[str]) -> None:
        """There are none."""

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        """There are none."""

    def wrote(self, generation: int) -> None:
        """There are none."""


class _Watch:
    """Notes when each step begins; as in the daemon, the thread of changes makes a moment of it, and no status."""

    def __init__(self) -> None:
        self.manager: Manager | None = None
        self.marks: list[tuple[int, str]] = []

    def progressed(self) -> None:
        """A step begins, or goes on."""
        self.status_changed()

    def status_changed(self) -> None:
        """A step goes on, or the change has ended."""
        progress = self.manager.reporter.moment().progress if self.manager else None
        name = progress.step if progress else "end"
        if not self.marks or self.marks[-1][1] != name:
            self.marks.append((time.monotonic_ns(), name))

    def registers_changed(self, values: RegValues) -> None:
        """Of no interest."""

    def interrupt(self, irq: Irq) -> None:
        """Of no interest."""


class _Port(Icap):
    """The port, with the times at which each load was requested, began, ended, and was reported (ns)."""

    times: list[tuple[int, int, int, int]]

    def load(self, *args: Any, **kwargs: Any) -> None:
        self.asked = time.monotonic_ns()
        super().load(*args, **kwargs)

    def wait(self, timeout: float | None = None) -> Any:
        done = super().wait(timeout)
        self.times.append((self.asked, done.started_ns, done.finished_ns, time.monotonic_ns()))
        return done


class _Devices(BoardDevices):
    """The board's devices, with a port that notes times."""

    port: _Port | None = None

    def icap(self, name: str | None) -> Icap:
        if self.port is None:
            self.port = _Port.open(name or "cm_icap0", Root.of(self.root))  # type: ignore[assignment]
            assert self.port is not None
            self.port.times = []
        return self.port


def run(bench: Run) -> list[Result]:
    """Measure `reconfigure`."""
    folder = _write_config(bench.place("c"))
    changes = 4 if bench.quick else 40
    with ExitStack() as stack:
        board = stack.enter_context(Board([folder / "bench.yaml"], arguments=["--icap-rate", str(RATE)]))
        manager, watch, devices = stack.enter_context(_manager(bench, folder, board.root))
        for mode in ("one", "two"):
            _change(manager, mode)
            _prefetched(manager)
        devices.port.times.clear()  # type: ignore[union-attr]
        splits = []
        for number in range(changes):
            watch.marks.clear()
            splits.append(_split(watch, _change(manager, ("one", "two")[number % 2])))
        times = list(devices.port.times)  # type: ignore[union-attr]
    return [_result(bench, splits, times)]


def _write_config(folder: Path) -> Path:
    (folder / "bench.yaml").write_text(_SCHEMA, encoding="utf-8")
    for name in ("one", "two"):
        image = assemble_module(name, device=_DEVICE, footprint=_footprint(), size=BYTES)
        (folder / f"{name}.bit").write_bytes(image)
    return folder


@contextmanager
def _manager(bench: Run, folder: Path, root: Path) -> Iterator[tuple[Manager, _Watch, _Devices]]:
    watch, devices = _Watch(), _Devices(Root.of(root))
    config = load(folder / "bench.yaml")
    journal = Journal(bench.place("state"))
    files = BoardFiles(root)
    env = Environment(devices, files, journal, _NoStreams(), _Clock(), watch, Settings())
    manager = watch.manager = Manager({config.name: config}, env)
    manager.start()
    try:
        yield manager, watch, devices
    finally:
        manager.stop()
        devices.lost()
        journal.close()


def _change(manager: Manager, mode: str) -> tuple[int, int]:
    """Go to a mode; returns when it was requested and when it was reached, ns."""
    done = threading.Event()
    ended: list[int] = []

    def end(_: Change) -> None:
        ended.append(time.monotonic_ns())
        done.set()

    asked = time.monotonic_ns()
    change = manager.submit(ChangeMode(config_name="bench", mode=mode), end)
    done.wait()
    if change.error is not None:
        raise Unavailable(f"the change to {mode} failed: {change.error.message}")
    return asked, ended[0]


def _prefetched(manager: Manager) -> None:
    """Images are read ahead after a change; a short change that follows waits for that."""
    manager.submit(ChangeMode(config_name="bench", mode=manager.state.mode or "")).wait()


def _split(watch: _Watch, ends: tuple[int, int]) -> dict[str, float]:
    """Milliseconds of each part of a change; `other` is decoupling, the record, and what lies between."""
    parts = dict.fromkeys([*PARTS.values(), "other"], 0.0)
    marks = [(ends[0], "request"), *watch.marks, (ends[1], "end")]
    for (begun, name), (ended, _) in pairwise(marks):
        parts[PARTS.get(name, "other")] += (ended - begun) / 1e6
    return {**parts, "total": (ends[1] - ends[0]) / 1e6}


def _result(bench: Run, splits: list[dict[str, float]], times: list[tuple[int, int, int, int]]) -> Result:
    median = {name: statistics.median(split[name] for split in splits) for name in splits[0]}
    transfer = BYTES / RATE * 1e3
    at_port = [(finished - started) / 1e6 for _, started, finished, _ in times]
    added = [((heard - asked) - (finished - started)) / 1e6 for asked, started, finished, heard in times]
    share = statistics.median(added) / transfer
    return Result(
        "reconfigure",
        median["total"],
        "ms",
        RAN,
        baseline=transfer,
        ratio=share,
        goal=SHARE,
        details={
            "split_ms": {**median, "trigger": statistics.median((s - a) / 1e6 for a, s, _, _ in times)},
            "load_at_port_ms": statistics.median(at_port),
            "software_at_load_ms": statistics.median(added),
            "software_of_whole_change_ms": median["total"] - statistics.median(at_port),
            "share_of_whole_change": (median["total"] - statistics.median(at_port)) / transfer,
            "changes": len(splits),
            **_trigger(bench),
        },
    )


def _trigger(bench: Run) -> dict[str, Any]:
    """µs from the call of the shim to the start of a transfer, at a port in C that does nothing else."""
    root = bench.place("p")
    try:
        with TimedPort(root), Icap.open(root=root) as icap, icap.allocate(4096) as buffer:
            found = sorted(_triggered(icap, buffer) for _ in range(20 if bench.quick else 5000))
    except Unavailable as why:
        return {"trigger_us": None, "trigger_missing": str(why), "trigger_goal": str(TRIGGER), "trigger_met": None}
    median = statistics.median(found)
    return {
        "trigger_us": median,
        "trigger_p99_us": found[len(found) * 99 // 100],
        "trigger_goal": str(TRIGGER),
        "trigger_met": TRIGGER.met(median),
    }


def _triggered(icap: Icap, buffer: Any) -> float:
    asked = time.monotonic_ns()
    icap.load(buffer, 4096)
    return (icap.wait(1.0).started_ns - asked) / 1e3
