# SPDX-License-Identifier: Apache-2.0
"""``cm stream list|set|capture|play|ping``: data streams."""

from __future__ import annotations

import argparse
import statistics
import time
from itertools import islice
from pathlib import Path

from cm.cli.arrays import array_of
from cm.cli.common import (
    add_board_options,
    add_lease_option,
    answer,
    completes,
    extents,
    natural,
    parsed,
    positive,
    print_json,
    print_table,
)  # fmt: skip
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
    settings = actions.add_parser(
        "set",
        help="change a stream's settings",
        description="Change a stream's settings. Those that you leave out stay as they are. The next change of mode "
        "brings the schema's settings back.",
    )
    _add_settings(settings)
    add_board_options(settings, run_set)
    capture = actions.add_parser("capture", help="write frames to files, or to standard output")
    completes(capture.add_argument("stream", metavar="STREAM"), "<stream>")
    add_arguments(capture)
    add_board_options(capture, run_capture)
    play = actions.add_parser("play", help="send the frames of a .npy file to the hardware")
    completes(play.add_argument("stream", metavar="STREAM"), "<stream>")
    play.add_argument("file", metavar="FILE.npy", type=Path, help="one frame, or frames along the first axis")
    add_board_options(play, run_play, lease=True)
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


def _add_settings(parser: argparse.ArgumentParser) -> None:
    add, switch, shape = parser.add_argument, argparse.BooleanOptionalAction, parsed("a shape such as 480x640", extents)
    fps = parsed("a number of frames per second above 0, or inf", float, lambda value: value > 0)
    completes(add("stream", metavar="STREAM"), "<stream>")
    add("--shape", type=shape, default=(), metavar="AxB…", help="shape of a whole frame, slowest axis first: 480x640")
    add("--dtype", default="", help="numpy's name of the element type, such as uint8")
    add("--slots", type=natural, default=0, metavar="N", help="number of buffers to begin with")
    add("--rate", type=fps, default=0.0, metavar="FPS", help="pass on at most so many frames per second; inf: all")
    add("--stride", type=natural, default=0, metavar="BYTES", help="bytes from one line to the next in memory")
    add("--direction", default="", help="s2mm or mm2s; changes nothing: it is refused unless it is the stream's own")
    add("--cyclic", action=switch, default=None, help="repeat a written frame until the next one, or send it once")
    add(
        "--backpressure",
        action=switch,
        default=None,
        help="let the hardware wait for readers, or let readers lose frames",
    )
    add("--enable", action=switch, default=None, help="run it, or stop it, whether or not it has readers")
    add("--automatic", action="store_true", help="run it while it is used, as before any --enable or --no-enable")
    add_lease_option(parser)
    add("--force", action="store_true", help="even if it is in use")


_SETTINGS = (
    "shape", "dtype", "slots", "rate", "stride", "direction", "cyclic", "backpressure", "enable", "automatic", "lease",
    "force",
)  # fmt: skip


def run_set(args: argparse.Namespace) -> int:
    """Change settings and print what they are now; the exit status."""
    with connected(args) as board:
        stream = board.configure_stream(args.stream, **{name: getattr(args, name) for name in _SETTINGS})
    shape = "x".join(map(str, stream.shape)) or "any length"
    text = f"{stream.name}: {shape} {_elements(stream)}, {stream.slots} slots, {', '.join(_switches(stream))}"
    return answer(args, plain(stream), text)


def _switches(stream: StreamStatus) -> list[str]:
    return [
        "cyclic" if stream.cyclic else "one-shot",
        "backpressure" if stream.backpressure else "no backpressure",
        f"stride {stream.stride}" if stream.stride else "lines follow each other",
        f"at most {stream.limit:g} frames/s" if stream.limit else "no limit",
    ]


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
            board.write(args.stream, frame, lease=args.lease)
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
