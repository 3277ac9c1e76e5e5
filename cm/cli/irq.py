# SPDX-License-Identifier: Apache-2.0
"""``cm irq list|wait|watch``: interrupts by name."""

from __future__ import annotations

import argparse
import re
import select
import time
from contextlib import ExitStack
from itertools import islice
from typing import TYPE_CHECKING

from cm.cli.common import add_board_options, answer, answer_table, completes, natural, seconds
from cm.cli.connection import check_reader, connected, followed
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from cm.wire.messages.status import Irq


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the interrupts of the loaded configuration")
    add_board_options(listing, run_list)
    wait = actions.add_parser("wait", help="wait for an interrupt")
    completes(wait.add_argument("name", metavar="NAME"), "<interrupt>")
    wait.add_argument("--timeout", type=seconds, metavar="SECONDS", help="give up after this time (exit status 1)")
    wait.add_argument(
        "--count", type=natural, default=1, metavar="N", help="wait for N interrupts (1); 0: until Ctrl-C"
    )
    add_board_options(wait, run_wait)
    watch = actions.add_parser("watch", help="print interrupts as they come, of several names, until Ctrl-C")
    completes(watch.add_argument("names", metavar="NAME", nargs="*", help="only these (default: all)"), "<interrupt>")
    watch.add_argument("--count", type=natural, default=0, metavar="N", help="stop after N of them (default: 0, never)")
    watch.add_argument(
        "--format",
        default="%S  %l %n",
        metavar="TEXT",
        help="%%l name, %%n count, %%S seconds since the board's start, %%U UTC, %%L local time ('%%S  %%l %%n')",
    )
    add_board_options(watch, run_watch)


def run_list(args: argparse.Namespace) -> int:
    """Print names and counts; the exit status."""
    with connected(args) as board:
        found = board.config().interrupts
    rows = [(i.name, i.count, i.doc) for i in found]
    return answer_table(args, [plain(i) for i in found], rows, ("NAME", "COUNT", "MEANING"))


def run_wait(args: argparse.Namespace) -> int:
    """Print each interrupt as it comes; the exit status."""
    with connected(args) as board:
        events = board.interrupts[args.name].events(args.timeout)
        for irq in islice(followed(board, events) if args.timeout is None else events, args.count or None):
            answer(args, plain(irq), f"{irq.name} {irq.count}  {irq.timestamp_ns / 1e9:.6f} s", lines=True)
    return 0


def run_watch(args: argparse.Namespace) -> int:
    """Print each interrupt in the form that is wanted, in the order of their times; the exit status."""
    with connected(args) as board, ExitStack() as open_:
        offset = board.status.realtime_offset_ns
        names = args.names or board.interrupts.names
        events = [open_.enter_context(board.interrupts[name].events()) for name in names]
        left = args.count or -1
        while left and events:
            select.select(events, [], [], 1.0)
            check_reader()
            came = [irq for each in events for irq in iter(each.poll, None)]
            for irq in sorted(came, key=lambda irq: irq.timestamp_ns)[: left if left > 0 else None]:
                answer(args, plain(irq), formatted(args.format, irq, offset), lines=True)
                left -= 1
    return 0


def formatted(form: str, irq: Irq, offset_ns: int) -> str:
    """`form` with what stands behind each %, as in gpiomon(1); `offset_ns`: CLOCK_REALTIME less CLOCK_MONOTONIC."""
    seconds, rest = divmod(irq.timestamp_ns + offset_ns, 10**9)
    micros = f"{rest // 1000:06d}"
    said = {
        "l": irq.name,
        "n": str(irq.count),
        "S": f"{irq.timestamp_ns // 10**9}.{irq.timestamp_ns % 10**9:09d}",
        "U": time.strftime(f"%Y-%m-%dT%H:%M:%S.{micros}Z", time.gmtime(seconds)),
        "L": time.strftime(f"%Y-%m-%dT%H:%M:%S.{micros}", time.localtime(seconds)),
        "%": "%",
    }
    return re.sub(r"%([lnSUL%])", lambda found: said[found[1]], form)
