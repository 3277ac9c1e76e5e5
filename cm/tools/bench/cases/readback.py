# SPDX-License-Identifier: Apache-2.0
"""What it takes to compare a region with what was loaded: one pass, and passes in the background."""

from __future__ import annotations

import statistics
import time
from contextlib import ExitStack
from pathlib import Path

from cm.device import Icap, IcapCompletion, Root
from cm.formats.bitstream.container import open_image
from cm.formats.bitstream.geometry import geometry_of
from cm.formats.bitstream.idcodes import device_by_name
from cm.formats.bitstream.mask import Mask
from cm.formats.bitstream.readback import LoadedFrames
from cm.formats.bitstream.simulated_module import assemble_module
from cm.manager.execution.region_readback import Reader
from cm.schema.model import FrameRange
from cm.simulation.software.process.child import Board
from cm.tools.bench.peer import Unavailable
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run
from cm.tools.bench.serving import cpu_percent, serve, settle

RATE = 400e6  # bytes per second: 32 bits at 100 MHz
FRAMES, FRAME = 1000, 404
BUDGET = 2.0  # percent
PASS, SCRUB = Goal(1.2), Goal(2.5)
RAN = (
    "a pass over 1,000 frames of the simulated board with an ICAP of 400 MB/s: requests, transfer, and comparison, in "
    "the slices that the manager reads; ratio: of the port's time for as many bytes with what software adds to it, to "
    "that time. What the simulated port takes longer than its clock says is not counted (port_ms has it)"
)
RAN_SCRUB = (
    "processor time of the process of cm serve while it compares a region all the time with a budget of 2 %, less what "
    "it uses when it has nothing to do; percent of one CPU"
)
_DEVICE = "xc7z020"
_SCHEMA = """
config:
  name: bench
  device: xc7z020
  regions: {prr0: {footprint: [{block_type: 0, row: 32, columns: [2, LAST]}]}}
  modules: {one: {region: prr0}}
  modes: {one: {modules: [one]}}
"""


def run(bench: Run) -> list[Result]:
    """Measure `readback_pass` and `readback_scrub`."""
    folder = bench.place("c")
    last = _last_column()
    (folder / "bench.yaml").write_text(_SCHEMA.replace("LAST", str(last)), encoding="utf-8")
    image = assemble_module("one", device=_DEVICE, footprint=(FrameRange(0, 32, 2, last),), size=1 << 30)
    (folder / "one.bit").write_bytes(image)
    return [_pass(bench, folder), _scrub(bench, folder)]


def _last_column() -> int:
    """The column that makes it as many frames as are wanted, or a few more."""
    geometry = geometry_of(_DEVICE)
    row = geometry.row(0, 32) if geometry else None
    assert row is not None
    return next(column for column in range(2, row.columns) if row.starts[column + 1] - row.starts[2] >= FRAMES)


class _Port(Icap):
    """The port, with what it took by its own clock (ms)."""

    took: float = 0.0

    def wait(self, timeout: float | None = None) -> IcapCompletion:
        done = super().wait(timeout)
        self.took += (done.finished_ns - done.started_ns) / 1e6
        return done


def _pass(bench: Run, folder: Path) -> Result:
    device = device_by_name(_DEVICE)
    assert device is not None
    frames = LoadedFrames(device, open_image(folder / "one.bit"), Mask(lambda _: {}, "none"))
    with ExitStack() as stack:
        board = stack.enter_context(Board([folder / "bench.yaml"], arguments=["--icap-rate", str(RATE)]))
        port = stack.enter_context(_Port.open(root=Root.of(board.root)))
        assert isinstance(port, _Port)
        _load(port, (folder / "one.bit"))
        reader = Reader(port)
        slices = frames.slices(reader.most_frames(frames.frame_bytes))
        took, at_port = [], []
        for _ in range(5 if bench.quick else 500):
            started, port.took = time.monotonic(), 0.0
            wrong = [*(reader.read(part) for part in slices), reader.rest()]
            took.append(1e3 * (time.monotonic() - started))
            at_port.append(port.took)
            if any(wrong):
                raise Unavailable("the simulated board does not hold what was loaded")
        reader.close()
    transfer = 1e3 * frames.judged * FRAME / RATE
    value = statistics.median(took)
    added = statistics.median(whole - port for whole, port in zip(took, at_port, strict=True))
    details = {
        "frames": frames.judged,
        "slices": len(slices),
        "port_ms": statistics.median(at_port),
        "software_ms": added,
        "p99_ms": sorted(took)[len(took) * 99 // 100],
    }
    return Result("readback_pass", value, "ms", RAN, transfer, (transfer + added) / transfer, PASS, details=details)


def _load(port: Icap, bitstream: Path) -> None:
    from cm.formats.bitstream.container import to_dma_words

    words = to_dma_words(bitstream)
    with port.allocate(len(words)) as buffer:
        buffer.memoryview()[: len(words)] = words
        port.load(buffer, len(words))
        if port.wait(60.0).status:
            raise Unavailable("the simulated board did not take the bitstream")


def _scrub(bench: Run, folder: Path) -> Result:
    seconds = 1.0 if bench.quick else 20.0
    settings = folder / "cm.yaml"
    settings.write_text(f"scrub: {{prr0: {{every: 100ms, budget: {BUDGET} %}}}}\n", encoding="utf-8")
    where = ("--config", str(folder / "bench.yaml"), "--load", "bench")
    shares = {}
    for name, more in (("quiet", ()), ("scrubbed", ("--settings", str(settings)))):
        with serve(bench, *where, *more) as served, served.connect() as board:
            settle(board)
            shares[name] = cpu_percent(served.pid, lambda: time.sleep(seconds))
            health = board.status.regions[0].health
    details = {**{f"percent_{name}": share for name, share in shares.items()}, "passes": health.checks if health else 0}
    value = shares["scrubbed"] - shares["quiet"]
    return Result("readback_scrub", value, "% of a CPU", RAN_SCRUB, goal=SCRUB, details=details)
