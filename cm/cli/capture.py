# SPDX-License-Identifier: Apache-2.0
"""``cm stream capture``: frames to files or standard output, each written when it comes."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from typing import TYPE_CHECKING, Any, TypeVar

from cm.cli.client import connected
from cm.cli.commands import EXIT_INTERRUPTED
from cm.cli.common import add_lease_option, binary_output, natural, print_json
from cm.cli.frame_files import FORMATS, Incomplete, Sink, sink
from cm.errors import Timeout
from cm.wire.lazy_numpy import np

if TYPE_CHECKING:
    from cm.client.stream import Stream

_T = TypeVar("_T")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments, except the stream."""
    parser.add_argument(
        "file", metavar="FILE", help="NAME.npy, NAME.png (numbered if several), NAME.raw, or - for standard output"
    )
    parser.add_argument("--count", type=natural, default=1, metavar="N", help="how many frames; 0: until Ctrl-C")
    add_lease_option(parser)
    parser.add_argument(
        "--format", choices=FORMATS, default="", help="format, if the file name does not say it (for -: npy)"
    )


def run_capture(args: argparse.Namespace) -> int:
    """Write frames; the exit status. Frames that came before a failure or Ctrl-C are in the files."""
    to = sink(args.file, args.format, args.count == 1, binary_output() if args.file == "-" else sys.stdout.buffer)
    capture = _Capture(to)
    try:
        with connected(args) as board, board.stream(args.stream, lease=args.lease) as stream, _Interrupt() as interrupt:
            interrupted = capture.take(stream, args.count, interrupt)
    except (OSError, Timeout) as error:
        if isinstance(error, BrokenPipeError) or not capture.sequences:
            raise
        raise Incomplete(f"{error.strerror if isinstance(error, OSError) else error}; {capture.told()}") from error
    finally:
        to.close()
    capture.tell(args.json, sys.stderr if args.file == "-" else sys.stdout)
    return EXIT_INTERRUPTED if interrupted else 0


class _Capture:
    """What was written so far."""

    def __init__(self, to: Sink) -> None:
        self._to = to
        self.sequences: list[int] = []
        self._remarks: list[str] = []
        self._like: tuple[Any, ...] = ()

    def take(self, stream: Stream, count: int, interrupt: _Interrupt) -> bool:
        """Write `count` frames (0: all); whether Ctrl-C ended it."""
        while not count or len(self.sequences) < count:
            try:
                frame = interrupt.during(stream.read)
            except KeyboardInterrupt:
                return True
            remark = self._to.add(np.asarray(frame))
            self.sequences.append(frame.sequence)
            self._like = self._like or (frame.shape, frame.dtype)
            frame.release()
            if remark:
                self._remarks.append(remark)
        return False

    def told(self) -> str:
        """In a sentence."""
        if not self.sequences:
            return "no frame came"
        number, files = len(self.sequences), self._to.files
        where = ", ".join(files) if len(files) < 4 else f"{files[0]} … {files[-1]}"
        shape, dtype = self._like
        return f"{number} frame{'s' if number > 1 else ''} of {shape} {dtype} in {where}"

    def tell(self, as_json: bool, to: Any) -> None:
        if as_json:
            shape = self._like[0] if self._like else ()
            told = {"files": self._to.files, "sequences": self.sequences, "shape": shape, "remarks": self._remarks}
            with redirect_stdout(to):
                print_json(told)
            return
        print(self.told(), file=to)
        for remark in self._remarks:
            print(f"  {remark}", file=to)


class _Interrupt:
    """Ctrl-C ends the waiting for a frame, never the writing of one."""

    def __init__(self) -> None:
        self._waits = self._asked = False
        self._before: Any = None

    def __enter__(self) -> _Interrupt:
        with suppress(ValueError):  # not in the main thread, where no key press arrives
            self._before = signal.signal(signal.SIGINT, self._pressed)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(ValueError):
            if self._before is not None:
                signal.signal(signal.SIGINT, self._before)

    def _pressed(self, *_: object) -> None:
        self._asked = True
        if self._waits:
            raise KeyboardInterrupt

    def during(self, wait: Callable[[], _T]) -> _T:
        """What `wait` gives. Raises KeyboardInterrupt."""
        self._waits = True
        try:
            if self._asked:
                raise KeyboardInterrupt
            return wait()
        finally:
            self._waits = False
