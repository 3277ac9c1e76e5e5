# SPDX-License-Identifier: Apache-2.0
"""``cm stream list|set|capture|play|ping``: data streams."""

from __future__ import annotations

import argparse
import statistics
import time
from itertools import islice
from pathlib import Path

from cm.cli.arrays import array_of
from cm.cli.common import add_board_options, answer, completes, own_lease, positive, print_json, print_table
from cm.cli.connection import connected
from cm.cli.stream_capture import add_arguments, run_capture
from cm.wire.lazy_numpy import np
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import StreamStatus


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the streams of the current mode")
    add_board_options(listing, run_list)
    capture = actions.add_parser("capture", help="write frames to files, or to standard output")
    completes(capture.add_argument("stream", metavar="STREAM"), "<stream>")
    add_arguments(capture)
    add_board_options(capture, run_capture)
    play = actions.add_parser("play", help="send the frames of a .npy file to the hardware")
    completes(play.add_argument("stream", metavar="STREAM"), "<stream>")
    play.add_argument("file", metavar="FILE.npy", type=Path, help="one frame, or frames along the first axis")
    add_board_options(play, run_play)
    ping = actions.add_parser("ping", help="measure how long frames take from completion to here")
    completes(ping.add_argument("stream", metavar="STREAM"), "<stream>")
    ping.add_argument("--count", type=positive, default=20, metavar="N", help="how many frames (20)")
    add_board_options(ping, run_ping)


def _elements(stream: StreamStatus) -> str:
    return f"{stream.dtype} {stream.format}".rstrip()


def run_list(args: argparse.Namespace) -> int:
    """Print the streams; the exit status."""
    with connected(args) as board:
        streams = board.status.streams
    if args.json:
        print_json([plain(s) for s in streams])
        return 0
    rows = [
        (
            s.name,
            s.channel,
            s.direction,
            "x".join(map(str, s.shape)) or (f"to {s.slot_bytes}" if s.slot_bytes else "-"),
            _elements(s),
            s.slots,
            *_flow(s),
        )
        for s in streams
    ]
    print_table(
        rows, ("NAME", "CHANNEL", "DIRECTION", "SHAPE", "DTYPE", "SLOTS", "FRAMES", "LOST", "ERRORS", "RATE", "LATENCY")
    )
    for s in streams:
        for c in s.clients:
            does = "writes" if c.writes else "reads"
            print(
                f"  {s.name}: {c.name or '?'} (pid {c.pid}) {does}: {c.frames} frames, {c.dropped} lost, holds {c.held}"
            )
        if s.exact:
            print(
                f"  {s.name}: its DMA cannot tell how much arrived: a frame that ends early is handed on as a whole one"
            )
        if s.last_error is not None:
            print(f"  {s.name}: {s.last_error.message}")
        if s.overruns:
            print(f"  {s.name}: subscribers over ZeroMQ fell behind {s.overruns} times")
    return 0


def _flow(stream: StreamStatus) -> tuple[str, ...]:
    if not stream.open:
        return ("-",) * 5
    return (
        str(stream.frames),
        str(stream.dropped),
        str(stream.errors),
        f"{stream.rate:.1f}/s",
        f"{stream.latency_us:.0f} us",
    )


def run_play(args: argparse.Namespace) -> int:
    """Send frames; the exit status."""
    data = array_of(args.file)
    with connected(args) as board:
        shape = next((s.shape for s in board.status.streams if s.name == args.stream), ())
        frames = data if data.ndim == len(shape) + 1 else data[np.newaxis]
        for frame in frames:
            board.write(args.stream, frame, lease=own_lease())
    told = {"frames": len(frames), "bytes": int(data.nbytes)}
    return answer(args, told, f"{len(frames)} frames, {data.nbytes} bytes sent to {args.stream}")


def run_ping(args: argparse.Namespace) -> int:
    """Print the time from a frame's completion to this process (both on one machine); the exit status."""
    times = []
    with connected(args) as board, board.stream(args.stream) as stream:
        for frame in islice(stream, args.count):
            times.append((time.monotonic_ns() - frame.timestamp_ns) / 1000)
    told = {"frames": len(times), "median_us": statistics.median(times), "max_us": max(times), "min_us": min(times)}
    text = (
        f"{len(times)} frames: median {told['median_us']:.0f} us, "
        f"min {told['min_us']:.0f} us, max {told['max_us']:.0f} us from completion to here"
    )
    return answer(args, told, text)
