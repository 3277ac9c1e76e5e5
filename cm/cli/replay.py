# SPDX-License-Identifier: Apache-2.0
"""``cm replay``: a record, run again on a simulated board."""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import answer, parsed, positive
from cm.errors import InvalidRequest
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from collections.abc import Callable

    from cm.tools.replay.script import Script


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Start a manager on a simulated board that gives back what the hardware gave in a record: registers, "
        "interrupts, frames and faults, in their order. An application runs against it unchanged; it begins with the "
        "application's first request. With --check the requests of the record are made again instead, and what the "
        "manager does is compared. What cannot be run again is named."
    )
    add = parser.add_argument
    add("file", nargs="?", type=Path, metavar="FILE", help="the record")
    add(
        "--from",
        dest="since",
        metavar="TIME",
        help="begin there: 12:03:07, or seconds since the beginning, such as +7.5",
    )
    add("--until", metavar="TIME", help="end there")
    speed = parsed("a number, 0 or more", float, lambda value: 0 <= value < float("inf"))
    add("--speed", type=speed, default=1.0, metavar="X", help="so many times as fast (1); 0: without pauses")
    add("--only", nargs="+", default=[], metavar="TOPIC", help="only these: cm_irq, cm_read_reg, or names of streams")
    add("--against", choices=("sim", "rtl"), default="sim", help="models in software (sim), or the design's HDL (rtl)")
    add("--build", type=Path, metavar="FILE", help="with --against rtl: build schema of the design")
    add("--check", action="store_true", help="make the record's requests again, and compare the states")
    add("--times", type=positive, default=1, metavar="N", help="with --check: so many times, each on a new board")
    add("--bag", type=Path, metavar="ROSBAG", help="a robot's bag (rosbag2, MCAP): its pictures come from the camera")
    add("--topic", default="", metavar="NAME", help="with --bag: the camera's topic (default: its only one)")
    add("--runtime-dir", type=Path, metavar="DIR", help="where the manager serves (default: a fresh folder, printed)")
    add("--json", action="store_true", help="print JSON, errors included")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run it; the exit status."""
    if args.bag is None and args.file is None:
        raise InvalidRequest("which record? cm replay FILE, or cm replay --bag ROSBAG")
    if args.bag is not None:
        return _bag(args)
    from cm.recording.reader import Record
    from cm.recording.times import time_in
    from cm.tools.replay.script import read_script, topics_wanted

    record = Record(args.file)
    since = time_in(args.since, record.opened) if args.since else 0
    until = time_in(args.until, record.opened) if args.until else 1 << 63
    wanted = topics_wanted(tuple(args.only))
    if args.against == "rtl":
        _say("not run again: registers, interrupts and frames of the record: the HDL has its own")
        wanted = lambda _: False  # noqa: E731
    script = read_script(record, since, until, wanted)
    for text in script.left_out:
        _say(f"not run again: {text}")
    return _check(args, script) if args.check else _play(args, script, wanted, since, until)


def _check(args: argparse.Namespace, script: Script) -> int:
    from cm.tools.replay.board import bench
    from cm.tools.replay.check import check

    alike, found = 0, None
    for _ in range(args.times):
        with bench(script, None, args.against, args.build) as made:
            found = check(made, script)
            config = made.board.config()
        alike += not found.differences
        for text in found.differences:
            print(text, file=sys.stderr)
        if found.differences and config.schema != script.schemas.get(config.name):
            _say(f"the configuration {config.name} of the design is not the one of the record (--build names another)")
    assert found is not None
    told = {
        "times": args.times, "alike": alike, "states": [plain(state) for state in found.recorded],
        "left_out": list(script.left_out),
    }  # fmt: skip
    lines = [f"{n}. {state}" for n, state in enumerate(found.recorded, 1)]
    answer(args, told, "\n".join([*lines, f"{alike} of {args.times} runs went through the same {len(lines)} states"]))
    return 0 if alike == args.times else 1


def _play(args: argparse.Namespace, script: Script, wanted: Callable[[str], bool], since: int, until: int) -> int:
    from cm.tools.replay.board import bench
    from cm.tools.replay.player import Player

    if any(step.kind == "repair" for change in script.changes for step in change.steps):
        _say("not run again: upsets and their repairs (with --check they are)")
    with bench(script, args.runtime_dir, args.against, args.build) as made:
        player = Player(made, script, wanted)
        ends = "; Ctrl-C ends it" if args.against == "rtl" else ""
        _say(f"ready: run the application with CM_RUNTIME_DIR={made.folder}{ends}")
        with contextlib.suppress(KeyboardInterrupt):
            player.wait_for_application()
            player.play(since, until, args.speed, on=args.against == "rtl")
    counts = dict(player.counts)
    return answer(
        args, counts, "\n".join(f"{count} {what}" for what, count in counts.items()) or "nothing to give back"
    )


def _bag(args: argparse.Namespace) -> int:
    """A simulated board whose camera takes the pictures of a bag, until interrupted."""
    from cm.cli import serve
    from cm.tools.replay.bag import pictures_of

    with tempfile.TemporaryDirectory(prefix="cm-bag-") as folder:
        count = pictures_of(args.bag, args.topic, Path(folder))
        _say(f"{count} pictures of {args.bag}")
        parser = argparse.ArgumentParser()
        serve.fill_parser(parser)
        words = ["--sim", "--images", folder, "--sim-hold", "1"]
        where = ["--runtime-dir", str(args.runtime_dir)] if args.runtime_dir else []
        return serve.run(parser.parse_args([*words, *where]))


def _say(text: str) -> None:
    print(f"cm replay: {text}", file=sys.stderr, flush=True)
