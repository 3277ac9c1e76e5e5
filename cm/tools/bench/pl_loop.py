# SPDX-License-Identifier: Apache-2.0
"""A loop through the simulated PL: frames there and back, and whether they are the ones that were sent."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager

import numpy as np

from cm.client.board import Board
from cm.client.stream import Stream
from cm.client.writer import Writer
from cm.errors import CmError
from cm.tools.bench.rounds import Batch, timed
from cm.tools.bench.run import Run
from cm.tools.bench.serving import PATIENCE, Served, serve, settle

LOOP = """
config:
  name: loop
  type: partial
  device: xc7z020
  regions:
    prr0: {decoupler: {base_address: 0x1000, offset: 0x0, bit: 0}}
  modules:
    loopback: {region: prr0, model: default}
  modes:
    loopback: {modules: [loopback]}"""
# One slot each way, as in the C program: with back-pressure none are kept in reserve for the hardware. No interrupt,
# because the baselines, too, only notify the other end.
STREAMS = """
  streams:
    to_pl: {{direction: mm2s, region: prr0, shape: [{shape}], slots: 1}}
    from_pl: {{direction: s2mm, region: prr0, shape: [{shape}], slots: 1, backpressure: true}}
"""


class WrongFrame(CmError):
    """What came back is not what was sent."""

    code = "wrong_frame"


@contextmanager
def echoed(bench: Run, size: int) -> Iterator[Batch]:
    """Round trips of a descriptor to the manager and back, with slots of `size` bytes; nothing is copied."""
    with ExitStack() as stack:
        board = stack.enter_context(stack.enter_context(serve(bench)).connect())
        yield timed(stack.enter_context(board.echo(size, PATIENCE)).round_trip)


@contextmanager
def looped(bench: Run, size: int) -> Iterator[Batch]:
    """Round trips PS–PL–PS of `size` bytes on a simulated board; after each batch the last frame is checked."""
    with ExitStack() as stack:
        board = stack.enter_context(stack.enter_context(serving(bench, size)).connect())
        settle(board)
        writer = stack.enter_context(board.writer("to_pl", PATIENCE, depth=1))
        reader = stack.enter_context(board.stream("from_pl", timeout=PATIENCE, depth=1))
        yield _checked(writer, reader, size)


@contextmanager
def looped_over_tcp(bench: Run, size: int) -> Iterator[Batch]:
    """The same for a client on another machine: frames to the manager and back over ZeroMQ and TCP, as copies."""
    with ExitStack() as stack:
        served = stack.enter_context(serving(bench, size, "--listen", "tcp://127.0.0.1:0", "--insecure"))
        told = json.loads((served.runtime_dir / "endpoints.json").read_text(encoding="utf-8"))
        board = stack.enter_context(Board(told["tcp"][0]["pub"], timeout=PATIENCE))
        settle(board)
        reader = stack.enter_context(board.stream("from_pl", timeout=PATIENCE))
        while not next(s for s in board.status.streams if s.name == "from_pl").open:
            time.sleep(0.01)  # its subscription is on the way
        sent = np.random.default_rng(1).integers(0, 256, size, np.uint8)

        def trip() -> None:
            board.write("to_pl", sent)
            if not np.array_equal(reader.read(), sent):
                raise WrongFrame("the frame that came back from the simulated PL is not the one that was sent")

        yield timed(trip)


def serving(bench: Run, size: int, *arguments: str, picture: bool = False) -> AbstractContextManager[Served]:
    """A manager in the loop's only mode; frames are of one axis, or a `picture` of one row."""
    schema = bench.place("l") / "loop.yaml"
    schema.write_text(LOOP + STREAMS.format(shape=f"1, {size}" if picture else size), encoding="utf-8")
    return serve(bench, "--config", str(schema), "--load", "loop/loopback", *arguments)


def _checked(writer: Writer, reader: Stream, size: int) -> Batch:
    random = np.random.default_rng(1)

    def trip() -> None:
        with writer.slot():
            pass  # the slot's content is sent again
        reader.read().release()

    batch = timed(trip)

    def checked(count: int) -> tuple[float, ...]:
        sent = random.integers(0, 256, size, np.uint8)
        _check(writer, reader, sent, lambda slot: np.copyto(slot, sent))
        durations = batch(count)
        _check(writer, reader, sent, lambda _: None)
        return durations

    return checked


def _check(writer: Writer, reader: Stream, sent: np.ndarray, fill: Callable[[np.ndarray], None]) -> None:
    """A trip that is not counted: fill the slot or leave it as it is, and compare what comes back."""
    with writer.slot() as slot:
        fill(slot)
    frame = reader.read()
    same = np.array_equal(frame, sent)
    frame.release()
    if not same:
        raise WrongFrame("the frame that came back from the simulated PL is not the one that was sent")
