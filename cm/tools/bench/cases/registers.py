# SPDX-License-Identifier: Apache-2.0
"""A register in a window, beside PYNQ's MMIO over memory; by its name, beside a bare REQ/REP of a request's bytes."""

from __future__ import annotations

import mmap
import os
import timeit
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np

from cm.client.core.calls import read_registers
from cm.device.register_window import MappedWindow
from cm.simulation.software.transport import protocol
from cm.tools.bench.cases.control import REGISTER, asking, same_bytes
from cm.tools.bench.peer import Peer
from cm.tools.bench.result import Goal, Result
from cm.tools.bench.rounds import Batch, interleave, timed
from cm.tools.bench.run import Run
from cm.tools.bench.serving import serve, settle
from cm.wire.messages.requests import ReadReg

AT_ONCE = 1000  # accesses between two looks at the clock, which takes as long as one of them
WINDOW = (
    "board.registers.window(): one read by name from Python, on the simulated board (a load from its mirror); "
    "baseline: the lines of pynq.mmio.MMIO.read that a 32-bit read runs, over ordinary memory"
)
REQUEST = (
    "board.registers[name]: one read by the Python client, over the data socket; details: the same by a request; "
    "baseline: pyzmq REQ/REP over ipc, with the frames of a request"
)


class Mmio:
    """What an access of 32 bits runs in PYNQ's MMIO (pynq/mmio.py): four lines, without its checks of arguments."""

    def __init__(self, memory: mmap.mmap) -> None:
        self.array = np.frombuffer(memory, np.uint32)

    def read(self, offset: int = 0) -> int:
        """A register's value."""
        return int(self.array[offset >> 2])

    def write(self, offset: int, value: int) -> None:
        """Write a register."""
        self.array[offset >> 2] = np.uint32(value)


def run(bench: Run) -> list[Result]:
    """Measure `register_window` and `register_request`."""
    with ExitStack() as stack:
        served = stack.enter_context(serve(bench))
        board = stack.enter_context(served.connect())
        settle(board)
        window = stack.enter_context(board.registers.window("prr0"))
        twin = stack.enter_context(as_on_a_board(window))
        pynq = Mmio(mmap.mmap(-1, mmap.PAGESIZE))
        there = {"window": window, "twin": twin, "pynq": pynq}
        batches = {
            "pynq_read": _many("pynq.read(0x10)", there),
            "pynq_write": _many("pynq.write(0x10, 2)", there),
            "window_read": _many(f"window.{REGISTER}", there),
            "mapped_read": _many(f"twin.{REGISTER}", there),
            "mapped_write": _many(f"twin.{REGISTER} = 2", there),
        }
        question = read_registers((REGISTER,))
        read = asking(stack, served, ReadReg((REGISTER,)))
        requests: dict[str, Batch] = {
            "bare": timed(stack.enter_context(Peer("zmq_reply", same_bytes(bench, read), 0)).trip),
            "client": timed(lambda: board.registers[REGISTER]),
            "request": timed(lambda: board.ask(question)),
        }
        for _ in range(100):  # the first are requests
            _ = board.registers[REGISTER]
        fast, slow = interleave(batches, bench.plan(20)), interleave(requests, bench.plan(200))
    ours, theirs = fast["window_read"], fast["pynq_read"]
    details = {
        "mapped_read_ratio": fast["mapped_read"].over(theirs),
        "mapped_write_ratio": fast["mapped_write"].over(fast["pynq_write"]),
        "samples": {name: found.plain() for name, found in fast.items()},
    }
    client, bare = slow["client"], slow["bare"]
    beside = {
        "request_ratio": slow["request"].over(bare),
        "samples": {name: found.plain() for name, found in slow.items()},
    }
    return [
        Result(
            "register_window", ours.median, "µs", WINDOW, theirs.median, ours.over(theirs), Goal(2.0), details=details
        ),
        Result(
            "register_request", client.median, "µs", REQUEST, bare.median, client.over(bare), Goal(0.25), details=beside
        ),
    ]


def _many(statement: str, names: dict[str, Any]) -> Batch:
    """A contestant whose trip is the mean of many of one statement."""
    timer = timeit.Timer(statement, globals=names)
    return lambda count: tuple([timer.timeit(AT_ONCE) / AT_ONCE * 1e6 for _ in range(count)])


@contextmanager
def as_on_a_board(window: Any) -> Iterator[Any]:
    """The same registers over mapped pages, as a kernel's grant has them: the path of a real board, without a bus.

    On the simulated board a write is a request to its process, which says nothing of a store.
    """
    fd = os.memfd_create("cm-bench", os.MFD_CLOEXEC)
    try:
        os.ftruncate(fd, 2 * mmap.PAGESIZE)
        os.pwrite(fd, protocol.WINDOW_STATE.pack(0, protocol.WINDOW_WRITE, mmap.PAGESIZE), 0)
        with MappedWindow(fd) as mapped:
            twin = object.__new__(type(window))
            twin._handle = mapped.shim_handle
            yield twin
    finally:
        os.close(fd)
