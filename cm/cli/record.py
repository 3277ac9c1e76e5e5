# SPDX-License-Identifier: Apache-2.0
"""``cm record``: what a manager tells its clients, into MCAP files."""

from __future__ import annotations

import argparse
import re
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_connection_options, add_json_option, answer, write_whole
from cm.errors import InvalidRequest, NotInstalled
from cm.extras import installing
from cm.manager.errors import hint

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cm.client.board import Board
    from cm.recording.record import Limits
    from cm.recording.recorder import Wanted

_SIZES = {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
_TIMES = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_LEAST = 1 << 20  # bytes of a file


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = "Record what a board does. `cm record FILE` is short for `cm record start FILE`."
    actions = parser.add_subparsers(metavar="ACTION", required=True)
    _add_start(actions)
    repairing = actions.add_parser("repair", help="write what is whole of a damaged record to another file")
    repairing.description = (
        "Write all messages that are whole to another file, which every reader takes, and say what is missing: of a "
        "record whose recorder was killed, whose disk was full, or that was damaged."
    )
    repairing.add_argument("file", type=Path, metavar="FILE", help="the damaged file")
    repairing.add_argument("out", nargs="?", type=Path, metavar="OUT", help="(default: FILE-repaired.mcap)")
    add_json_option(repairing, repair)
    plotting = actions.add_parser("plot", help="draw a record: modes, changes, faults, frames and upsets over time")
    plotting.add_argument("file", type=Path, metavar="FILE", help="the record")
    plotting.add_argument("out", type=Path, metavar="OUT.svg", help="the picture")
    add_json_option(plotting, plot)


def _add_start(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser("start", help="record until interrupted")
    parser.description = (
        "Record what the manager tells its clients: statuses, steps of changes, writes of registers and who made "
        "them, interrupts, leases, errors, upsets, and frames of the streams that are named. The record is an MCAP "
        "file, or several that follow each other; docs/record.md says what is in it."
    )
    add_connection_options(parser)
    parser.add_argument(
        "file",
        nargs="?",
        type=Path,
        metavar="FILE",
        help="file to write, or a folder for --split and --ring (default: BOARD-DATE-TIME.mcap, in this folder)",
    )
    parser.add_argument(
        "--streams",
        nargs="+",
        default=["none"],
        metavar="NAME",
        help="streams whose frames are recorded: names, all (but those with back-pressure, which a slow reader would "
        "hold up), or none (default). A stream runs while it is recorded",
    )
    parser.add_argument(
        "--frames",
        nargs="+",
        default=["whole"],
        metavar="WHAT",
        help="whole (default), every N: only the data of each N-th, or hash: the SHA-256 of each instead",
    )
    parser.add_argument("--split", default="", metavar="AMOUNT", help="begin another file after 1GiB, or 10min")
    parser.add_argument("--ring", default="", metavar="AMOUNT", help="keep only the last 5min, or 2GiB")
    parser.add_argument(
        "--settings",
        nargs="?",
        const="/etc/cm/cm.yaml",
        metavar="FILE",
        help="be the black box that `record` in the settings (/etc/cm/cm.yaml) describes; cm-record.service is",
    )
    parser.add_argument(
        "--ros2",
        action="store_true",
        help="write the topics of the ROS 2 node (docs/ros2.md) instead, into a folder that ros2 bag and rosbags read",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Record until interrupted; the exit status."""
    if args.settings is not None and not _take_settings(args):
        return 0
    recorder_module()
    limits, wanted = limits_of(args.split, args.ring), wanted_of(args.streams, args.frames)
    place = args.file
    if place is not None and limits.is_ring and place.suffix == ".mcap":
        raise InvalidRequest(f"--ring keeps several files: name a folder, such as {place.with_suffix('')}")
    from cm.client.board import connect
    from cm.recording.recorder import Recorder

    def connected(guest: str = "") -> Board:
        return connect(args.connect, runtime_dir=args.runtime_dir, keys=args.keys, guest=guest)

    with connected() as board:
        _tell_unknown(board, wanted.streams)
        told = board.status
    name = f"{told.board}-{time.strftime('%Y%m%d-%H%M%S')}"
    place = place or Path(name if limits.is_ring or args.ros2 else f"{name}.mcap")
    if args.ros2:
        return _as_ros(connected, place, limits, wanted, told.board)
    recorder = Recorder(connected, place, limits, wanted, _tell)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: recorder.stop())
    _tell(f"into {place}; Ctrl-C ends it")
    missing = recorder.run()
    if missing:
        _tell(f"{missing} messages are in no file, since the disk took no more")
    return 1 if missing else 0


def _tell_unknown(board: Board, streams: Sequence[str]) -> None:
    """Name the streams that none of the configurations has: of those nothing is recorded, as it stands."""
    from cm.recording.recorder import ALL

    infos = [board.config(name) for name in board.configs] if set(streams) - {ALL} else []
    known = [stream for info in infos for stream in info.streams]
    there = {stream.name for stream in known if stream.direction == "s2mm"}
    words = re.findall(r"[\w.-]+", " ".join(info.schema for info in infos))  # modes may have streams of their own
    for name in sorted(set(streams) - {ALL} - there - ({*words} - {stream.name for stream in known})):
        _tell(f"no configuration has a stream {name!r} from the hardware{hint(name, there)}")


def _take_settings(args: argparse.Namespace) -> bool:
    """Put what the settings say in the place of options; False if they want no record."""
    if args.file is not None or args.split or args.ring:
        raise InvalidRequest("--settings says where to and how much: name no file, --split or --ring beside it")
    from cm.server.settings.loader import load_settings

    settings = load_settings(Path(args.settings))
    said = settings.record
    if not said.ring:
        _tell(f"{args.settings} has no `record: {{ring: …}}`: nothing is recorded")
        return False
    args.file, args.ring = Path(said.folder), said.ring
    args.streams, args.frames = list(said.streams) or ["none"], said.frames.split()
    args.runtime_dir = args.runtime_dir or settings.runtime_dir
    return True


def _as_ros(connected: Callable[..., Board], place: Path, limits: Limits, wanted: Wanted, name: str) -> int:
    """Record what the ROS 2 node would publish; the exit status."""
    import threading

    from cm.networks.bridge.commands import Commands
    from cm.networks.bridge.follower import Follower
    from cm.networks.ros.node import BoardNode, NodeName
    from cm.networks.rosbag import RecordingTransport

    if wanted.every != 1 or place.suffix == ".mcap":
        raise InvalidRequest("--ros2 writes whole frames, into a folder: its name does not end in .mcap")
    transport = RecordingTransport(place, name, limits, wanted.streams, _tell)
    commands = Commands(connected, frozenset())
    node = BoardNode(transport, NodeName(), commands)
    follower, ended = Follower(connected, node), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    following = threading.Thread(target=follower.run, name="follower", daemon=True)
    following.start()
    _tell(f"into {place}; Ctrl-C ends it")
    due = time.monotonic() + 1
    while not ended.wait(node.look()):
        if time.monotonic() >= due:
            due += 1
            transport.record.tick()
    follower.stop()
    commands.close()
    following.join()
    node.close()
    transport.close()
    return 1 if transport.record.missing else 0


def repair(args: argparse.Namespace) -> int:
    """Repair a file; the exit status."""
    try:
        from cm.recording.repair import repair as repaired
    except ModuleNotFoundError as error:
        if error.name != "mcap":
            raise
        raise NotInstalled(f"cm record repair needs mcap: {installing('record')}") from None
    target = args.out or args.file.with_name(f"{args.file.stem}-repaired.mcap")
    found = repaired(args.file, target)
    lines = [f"{args.file}: {text}" for text in found.lost]
    if found.orphans:
        lines.append(f"{args.file}: {found.orphans} messages are whole, but what they mean is lost")
    text = "\n".join([*lines, f"{found.messages} messages are in {target}"])
    told = {"file": str(target), "messages": found.messages, "orphans": found.orphans, "lost": list(found.lost)}
    return answer(args, told, text)


def plot(args: argparse.Namespace) -> int:
    """Draw a record; the exit status."""
    from cm.recording.plot import drawn, svg
    from cm.recording.reader import Record

    record = Record(args.file)
    if any(args.out.exists() and args.out.samefile(file) for file in record.files):
        raise InvalidRequest(f"{args.out} is a file of the record: name another for the drawing")
    write_whole(args.out, svg(drawn(record)).encode())
    told = {"file": str(args.out), "problems": record.problems}
    return answer(args, told, "\n".join([*record.problems, f"wrote {args.out}"]))


def recorder_module() -> None:
    """Raise NotInstalled where the library is absent that writes records."""
    try:
        import mcap  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "mcap":
            raise
        raise NotInstalled(f"cm record needs mcap: {installing('record')}") from None


def _tell(text: str) -> None:
    print(f"cm record: {text}", file=sys.stderr, flush=True)


def limits_of(split: str, ring: str) -> Limits:
    """When a file ends, and which are removed. Raises InvalidRequest."""
    from cm.recording.record import Limits

    (split_bytes, split_seconds), (ring_bytes, ring_seconds) = amount("--split", split), amount("--ring", ring)
    if 0 < split_bytes < _LEAST or 0 < ring_bytes < 8 * _LEAST:
        raise InvalidRequest("a file takes 1MiB at least, and a ring eight of them")
    return Limits(split_bytes, split_seconds, ring_bytes, ring_seconds)


def amount(option: str, text: str) -> tuple[int, float]:
    """``1GiB`` → bytes, 0; ``10min`` → 0, seconds; empty: 0, 0. Raises InvalidRequest."""
    digits = text.rstrip("".join({*"".join((*_SIZES, *_TIMES))}))
    unit = text[len(digits) :]
    try:
        value = float(digits) if text else 0.0
    except ValueError:
        value = -1.0
    if text and not (0 < value < 1e9 and (unit in _SIZES or unit in _TIMES)):
        raise InvalidRequest(f"{option} {text}: an amount is a number with {', '.join((*_SIZES, *_TIMES))}")
    return (int(value * _SIZES[unit]), 0.0) if unit in _SIZES else (0, value * _TIMES.get(unit, 0.0))


def wanted_of(streams: list[str], frames: list[str]) -> Wanted:
    """Which frames are recorded. Raises InvalidRequest."""
    from cm.recording.recorder import ALL, Wanted

    alone = {ALL, "none"} & set(streams)
    if alone and len(streams) > 1:
        raise InvalidRequest(f"--streams: {alone.pop()} stands alone")
    names = () if streams == ["none"] else tuple(streams)
    if frames == ["whole"]:
        return Wanted(names)
    if frames == ["hash"]:
        return Wanted(names, every=0, hashed=True)
    if len(frames) == 2 and frames[0] == "every" and frames[1].isdecimal() and int(frames[1]):
        return Wanted(names, every=int(frames[1]))
    raise InvalidRequest(f"--frames {' '.join(frames)}: whole, every N, or hash")
