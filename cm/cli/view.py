# SPDX-License-Identifier: Apache-2.0
"""``cm view STREAM``: the newest frames, in the terminal or a window."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from cm.cli.common import add_connection_options, completes, extents, natural, parsed
from cm.cli.connection import connected
from cm.cli.view_terminal import WAYS, Screen, into_file, on_terminal
from cm.client.board import Board
from cm.client.frame import Frame
from cm.errors import InvalidRequest, Timeout

_LOOK = 0.5  # seconds without a frame, after which keys are looked at again and the line says so


class _Place(Protocol):
    def draw(self, frame: Frame, says: str) -> None: ...

    def say(self, line: str) -> None: ...


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Keep drawing the newest frame until q or Ctrl-C is pressed: with sixels or kitty's graphics "
        "protocol, if the terminal has them and the extra fpga-cm[view] is installed, otherwise with half blocks. "
        "Works over ssh."
    )
    rate = parsed("a number of pictures per second", float, lambda value: 0 < value <= 1000)
    size = parsed("a size such as 80x24", extents, lambda s: len(s) == 2 and all(0 < extent <= 4096 for extent in s))
    completes(parser.add_argument("stream", metavar="STREAM"), "<stream>")
    parser.add_argument(
        "--as",
        dest="way",
        choices=("auto", *WAYS, "window"),
        default="auto",
        help="how to draw (auto: the best that the terminal has)",
    )
    parser.add_argument(
        "--rate", type=rate, default=15.0, metavar="FPS", help="at most so many pictures per second (15)"
    )
    parser.add_argument(
        "--count", type=natural, default=0, metavar="N", help="stop after N pictures; 1 stays on the screen"
    )
    parser.add_argument(
        "--size", type=size, metavar="COLUMNSxROWS", help="size for output that is not a terminal (80x24)"
    )
    add_connection_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Show frames; the exit status."""
    with connected(args) as board:
        if args.way == "window":
            _show_window(args, board)
        else:
            with _screen(args) as screen:
                _show(args, board, screen)
    return 0


@contextmanager
def _screen(args: argparse.Namespace) -> Iterator[Screen]:
    if not sys.stdout.isatty():
        if args.way == "auto":
            raise InvalidRequest(
                "standard output is not a terminal: choose --as kitty, sixel or blocks, or --as window; "
                "'cm stream capture' writes files"
            )
        yield into_file(args.way, args.size or (80, 24))
        return
    with on_terminal(args.way) as screen:
        yield screen


def _show(args: argparse.Namespace, board: Board, screen: Screen) -> None:
    if args.count == 1:
        with board.stream(args.stream, newest=True) as stream:
            screen.once(stream.read())
        return
    screen.begin()
    try:
        _follow(args, board, screen, screen.ended)
    finally:
        screen.end()


def _show_window(args: argparse.Namespace, board: Board) -> None:
    try:
        import tkinter

        from cm.cli.view_window import Window
    except ModuleNotFoundError:
        raise InvalidRequest("a window needs Tk: apt install python3-tk, or look in the terminal") from None
    try:
        window = Window(f"{args.stream} - {board.status.board}")
    except tkinter.TclError as error:
        raise InvalidRequest(
            f"no window can be opened here ({error}); without --as it is drawn in the terminal"
        ) from None
    try:
        _follow(args, board, window, lambda: not window.look())
    finally:
        window.close()


def _follow(args: argparse.Namespace, board: Board, place: _Place, ended: Callable[[], bool]) -> None:
    drawn, due = 0, 0.0
    with board.stream(args.stream, timeout=_LOOK, newest=True) as stream:
        while not ended():
            try:
                frame = stream.read()
            except Timeout as nothing:
                place.say(f"{nothing} (q ends)")
                continue
            if time.monotonic() < due:
                frame.release()
                continue
            due = time.monotonic() + 1 / args.rate
            place.draw(frame, _says(frame, stream.lost))
            frame.release()
            drawn += 1
            if drawn == args.count:
                return


def _says(frame: Frame, lost: int) -> str:
    info = frame.info
    shape = " × ".join(map(str, info.shape))
    return (
        f"{info.stream}  {info.config_name}/{info.mode}  {shape} {info.dtype}  #{info.sequence}  lost {lost}  (q ends)"
    )
