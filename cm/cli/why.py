# SPDX-License-Identifier: Apache-2.0
"""``cm why``: why a board, or one in a record, is in its state."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import add_board_options, answer, completes
from cm.cli.connection import connected
from cm.errors import InvalidRequest

if TYPE_CHECKING:
    from cm.recording.story import Story


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Say why the board is as it is: who asked for what it holds and when, how long that took, what failed, who "
        "wrote a register. What was not recorded is 'not known'. With a record of `cm record`, say this of its end, "
        "or of a time within it."
    )
    subject = parser.add_argument(
        "subject",
        nargs="?",
        default="",
        metavar="REGION|REGISTER|STREAM",
        help="only this (default: all that is there)",
    )
    completes(subject, "<region>", "<register>", "<stream>")
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="a record instead of the manager that runs")
    parser.add_argument(
        "--at", metavar="TIME", help="in the record: 12:03:07, or seconds since its beginning, such as +7.5"
    )
    add_board_options(parser, run)


def run(args: argparse.Namespace) -> int:
    """Print sentences; the exit status."""
    from cm.recording.why import explain

    subject, file = args.subject, args.file
    if file is None and (subject.endswith(".mcap") or "/" in subject or any(Path(subject or "-").glob("*.mcap"))):
        subject, file = "", Path(subject)
    if args.at is not None and file is None:
        raise InvalidRequest("--at TIME is a time of a record: name its file")
    lines = explain(_present(args) if file is None else _recorded(file, args.at), subject)
    return answer(args, lines, "\n".join(lines))


def _present(args: argparse.Namespace) -> Story:
    from cm.client.core import calls
    from cm.recording.story import of_manager
    from cm.wire.messages.status import ConfigInfo

    with connected(args) as board:
        status = board.ask(calls.history())
        config = board.config() if status.config_name else ConfigInfo()
    return of_manager(status, config, time.time_ns())


def _recorded(file: Path, at: str | None) -> Story:
    from cm.recording.layout import STREAM_PREFIX
    from cm.recording.reader import Record
    from cm.recording.story import of_record
    from cm.recording.times import until

    record = Record(file)
    events = record.events(lambda topic: not topic.startswith(STREAM_PREFIX))
    return of_record(record.opened, until(events, record.opened, at) if at is not None else events)
