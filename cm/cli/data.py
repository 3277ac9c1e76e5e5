# SPDX-License-Identifier: Apache-2.0
"""``cm data STREAM …``: configure a data channel."""

from __future__ import annotations

import argparse
from typing import Any

from cm.cli.client import connected, plain
from cm.cli.common import add_connection_options, add_json_option, add_lease_option, completes, natural, print_json


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("data", help="configure the data channels")
    completes(parser.add_argument("stream", metavar="STREAM"), "<stream>")
    parser.add_argument("--shape", type=_shape, metavar="480x640", help="shape of one frame")
    parser.add_argument("--dtype", metavar="TYPE", help="a numpy dtype, such as uint8")
    parser.add_argument("--slots", type=natural, metavar="N", help="buffers in the ring")
    parser.add_argument("--rate", type=float, metavar="HZ", help="pass on at most so many frames per second")
    parser.add_argument(
        "--start", dest="enable", action="store_const", const=True, help="run it, whether or not it has readers"
    )
    parser.add_argument("--stop", dest="enable", action="store_const", const=False, help="stop it for all clients")
    parser.add_argument("--force", action="store_true", help="even if it is in use")
    add_lease_option(parser)
    add_connection_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=run)


def _shape(text: str) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a shape such as 480x640 or 480x640x3") from None


def run(args: argparse.Namespace) -> int:
    """Configure, and print what it is then; the exit status."""
    wanted: dict[str, Any] = {
        n: getattr(args, n) for n in ("shape", "dtype", "slots", "rate", "enable", "force", "lease")
    }
    with connected(args) as board:
        state = board.configure_stream(args.stream, **{n: v for n, v in wanted.items() if v is not None})
    if args.json:
        print_json(plain(state))
    else:
        shape = "x".join(map(str, state.shape)) or "as it comes"
        print(f"{state.name}: {state.direction} {shape} {state.dtype}, {state.slots} slots, {_open(state.open)}")
    return 0


def _open(is_open: bool) -> str:
    return "open" if is_open else "closed"
