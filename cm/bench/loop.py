# SPDX-License-Identifier: Apache-2.0
"""The loop of the camera example: frames to the PL and back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from cm.bench.run import Run
from cm.bench.serving import serve, settle

TO, FROM, MODE = "to_pl", "from_pl", "loopback"


@contextmanager
def looped(bench: Run, size: int) -> Iterator[Callable[[], object]]:
    """A round trip PS–PL–PS of `size` bytes on a simulated board, as a function."""
    with ExitStack() as stack:
        board = stack.enter_context(stack.enter_context(serve(bench)).connect())
        settle(board)
        board.load("camera", MODE, timeout=60.0)
        for name in (TO, FROM):
            board.configure_stream(name, shape=(size,), dtype="uint8", force=True)
        writer = stack.enter_context(board.writer(TO))
        reader = stack.enter_context(board.stream(FROM))
        with writer.slot() as slot:
            slot[...] = 0x5A

        def trip() -> None:
            with writer.slot():
                pass  # what lies in the slot goes again
            reader.read().release()

        reader.read()
        yield trip
