# SPDX-License-Identifier: Apache-2.0
"""1 MiB there and back through an AXI DMA: transfers by the manager, beside PYNQ's lines on the engine's registers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack

import numpy as np

from cm.client.allocation import DeviceArray
from cm.client.writer import Transfers
from cm.device import Uio
from cm.errors import CmError
from cm.simulation.software import Board as SimulatedBoard
from cm.tools.bench.machine import unpinned
from cm.tools.bench.pl_loop import LOOP, WrongFrame
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Batch, interleave, timed
from cm.tools.bench.run import Run
from cm.tools.bench.serving import PATIENCE, serve, settle

SIZE = 1 << 20
WRITES = 6  # of registers, in a trip of PYNQ's
BASE = 0x40400000
# An engine without scatter/gather, as most overlays have. Its registers are a driver's on a board; here a memory lays
# them open, so that both drive the same engine.
SCHEMA = f"""{LOOP}
  memories:
    dma_registers: {{base_address: {BASE}, size: 0x1000}}
  streams:
    dma_mm2s: {{direction: mm2s, region: prr0}}
    dma_s2mm: {{direction: s2mm, region: prr0}}
  blocks:
    dma:
      vlnv: xilinx.com:ip:axi_dma:7.1
      base_address: {BASE}
      size: 0x1000
      streams: [dma_mm2s, dma_s2mm]
"""
RAN = (
    "1 MiB there and back through a simulated AXI DMA in simple mode, in memory of board.allocate, no copy: "
    "board.transfers, begin and flush each way, which cm.pynq's DMA calls; all CPUs; baseline: what transfer() and "
    "wait() of PYNQ's DMA do to the registers of the same engine: six writes, each a request to the simulated board "
    "where a board has a store (a ratio leaves them out), and polling"
)


class Channel:
    """What a transfer runs in PYNQ's simple mode without an interrupt (pynq/lib/dma.py, 3.0.1), by the registers."""

    def __init__(self, engine: Uio, offset: int) -> None:
        self._engine, self._offset = engine, offset
        self._array: DeviceArray | None = None
        engine.write(offset, 1)

    def _status(self, mask: int) -> int:
        return self._engine.read(self._offset + 4) & mask

    def transfer(self, array: DeviceArray) -> None:
        """Start it."""
        if self._status(1) or not (self._status(2) or self._array is None):
            raise CmError("the engine is halted or busy")
        array.hand_over(to_device=True)
        address = array.device_address
        self._engine.write(self._offset + 0x18, address & 0xFFFFFFFF)
        self._engine.write(self._offset + 0x1C, address >> 32)
        self._engine.write(self._offset + 0x28, array.nbytes)
        self._array = array

    def wait(self) -> int:
        """Poll until it has ended; how many bytes were moved."""
        if self._status(1) or self._array is None:
            raise CmError("the engine is halted, or nothing was begun")
        while True:
            error = self._status(0xFFFFFFFF)
            if self._status(0x70):
                raise CmError(f"the engine failed: status {error:#x}")
            if self._status(2):
                break
        self._array.hand_over(to_device=False)
        return self._engine.read(self._offset + 0x28)


def run(bench: Run) -> list[Result]:
    """Measure `pynq_transfer`."""
    with ExitStack() as stack:
        stack.enter_context(unpinned(set(bench.cpus)))
        schema = bench.place("p") / "loop.yaml"
        schema.write_text(SCHEMA, encoding="utf-8")
        simple = [f"--simple-dma={name}:26" for name in ("dma_mm2s", "dma_s2mm")]
        simulated = stack.enter_context(SimulatedBoard([schema], arguments=simple))
        places = ("--config", str(schema), "--root", str(simulated.root), "--load", "loop/loopback")
        board = stack.enter_context(stack.enter_context(serve(bench, *places, sim=False)).connect())
        settle(board)
        arrays = board.allocate(SIZE), board.allocate(SIZE)
        send, receive = (stack.enter_context(board.transfers(name, PATIENCE)) for name in ("dma_mm2s", "dma_s2mm"))
        engine = stack.enter_context(Uio.open(BASE, simulated.root))
        trips = {"ours": _ours(send, receive, *arrays), "pynq": _theirs(engine, *arrays)}
        found = interleave({**trips, "write": timed(lambda: engine.write(0x18, 0))}, bench.plan(50))
    ours, theirs = found["ours"], found["pynq"]
    details = {
        "ratio_without_writes": ours.median / (theirs.median - WRITES * found["write"].median),
        "samples": {name: samples.plain() for name, samples in found.items()},
    }
    return [
        Result("pynq_transfer", ours.median, "µs", RAN, theirs.median, ours.over(theirs), Goal(0.8), details=details)
    ]


def _ours(send: Transfers, receive: Transfers, source: DeviceArray, result: DeviceArray) -> Batch:
    def trip() -> None:
        receive.begin(result)
        send.begin(source)
        send.flush()
        receive.flush()

    return _checked(trip, source, result)


def _theirs(engine: Uio, source: DeviceArray, result: DeviceArray) -> Batch:
    send, receive = Channel(engine, 0x00), Channel(engine, 0x30)

    def trip() -> None:
        receive.transfer(result)
        send.transfer(source)
        send.wait()
        receive.wait()

    return _checked(trip, source, result)


def _checked(trip: Callable[[], object], source: DeviceArray, result: DeviceArray) -> Batch:
    """The trips of a batch, and one more of which the bytes are compared."""
    random = np.random.default_rng(1)
    batch = timed(trip)

    def checked(count: int) -> tuple[float, ...]:
        durations = batch(count)
        source[:] = random.integers(0, 256, SIZE, np.uint8)
        trip()
        if not np.array_equal(source, result):
            raise WrongFrame("what came back from the simulated PL is not what was sent")
        return durations

    return checked
