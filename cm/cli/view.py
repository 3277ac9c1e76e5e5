# SPDX-License-Identifier: Apache-2.0
"""``cm view``: a stream in the terminal, also over ssh."""

from __future__ import annotations

import argparse
import sys
import time

from cm.cli.common import add_connection_options, completes, natural
from cm.cli.connection import connected
from cm.cli.view_terminal import Screen, on_terminal
from cm.client.board import Board
from cm.client.frame import Frame
from cm.errors import InvalidRequest, Timeout

_LOOK = 0.5  # seconds without a frame, after which keys are looked at again and the line says so
_BETWEEN = 1 / 15  # seconds between two pictures, which a slow line can take


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Keep drawing the newest frame in half blocks, two pixels to a character, until q or Ctrl-C is pressed. "
        "Works over ssh; `cm web` shows every pixel."
    )
    completes(parser.add_argument("stream", metavar="STREAM"), "<stream>")
    parser.add_argument(
        "--count", type=natural, default=0, metavar="N", help="stop after N pictures; 1 stays on the screen"
    )
    add_connection_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Show frames; the exit status."""
    with connected(args) as board:
        if not sys.stdout.isatty():
            raise InvalidRequest("standard output is not a terminal: 'cm stream capture' writes files")
        with on_terminal() as screen:
            _show(args, board, screen)
    return 0


def _show(args: argparse.Namespace, board: Board, screen: Screen) -> None:
    if args.count == 1:
        with board.stream(args.stream, newest=True) as stream:
            screen.once(stream.read())
        return
    screen.begin()
    try:
        _follow(args, board, screen)
    finally:
        screen.end()


def _follow(args: argparse.Namespace, board: Board, screen: Screen) -> None:
    drawn, due = 0, 0.0
    with board.stream(args.stream, timeout=_LOOK, newest=True) as stream:
        while not screen.ended():
            try:
                frame = stream.read()
            except Timeout as nothing:
                screen.say(f"{nothing} (q ends)")
                continue
            if time.monotonic() < due:
                frame.release()
                continue
            due = time.monotonic() + _BETWEEN
            screen.draw(frame, _says(frame, stream.lost))
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
