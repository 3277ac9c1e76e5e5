# SPDX-License-Identifier: Apache-2.0
"""``cm status`` and ``cm watch``: what is loaded and what is going on."""

from __future__ import annotations

import argparse
import os
import sys
import time

from cm.cli.colours import painted
from cm.cli.common import add_board_options, answer_table, natural, print_json, print_table, seconds
from cm.cli.connection import awaited, connected, followed, settled, where, window_use
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import NOTICES, RegionHealth, Status, place

_COLOURS = {"idle": "green", "partial": "yellow", "full": "yellow", "error": "red"}
_REGION_COLOURS = {
    "ready": "green", "failed": "red", **dict.fromkeys(("unknown", "decoupled", "loading", "loaded"), "yellow")
}  # fmt: skip
_UNITS = {"temperature": "°C", "voltage": "V", "current": "A", "power": "W"}


def add_status(parser: argparse.ArgumentParser) -> None:
    """Add the command."""
    add_board_options(parser, run)
    parser.add_argument(
        "--wait",
        nargs="?",
        type=seconds,
        const=30.0,
        metavar="SECONDS",
        help="for a manager that is starting: wait until it answers and no change is running (default: at most 30)",
    )
    parser.add_argument(
        "--clients", action="store_true", help="instead, show what each client takes of the manager's resources"
    )


def run(args: argparse.Namespace) -> int:
    """Print the status; the exit status."""
    if args.clients:
        return run_clients(args)
    with connected(args) if args.wait is None else awaited(args, args.wait) as board:
        status = board.status if args.wait is None else settled(board, args.wait)
    if args.json:
        print_json(plain(status))
    else:
        show(status)
    return 0


def run_clients(args: argparse.Namespace) -> int:
    """Print what each client uses; the exit status."""
    with connected(args) if args.wait is None else awaited(args, args.wait) as board:
        clients = board.clients()
    rows = [
        (
            x.name,
            x.account or "-",
            x.connections,
            x.leases,
            x.slots,
            x.waiting,
            _mebibytes(x.waiting_bytes),
            _mebibytes(x.unread_bytes),
            _mebibytes(x.upload_bytes),
            _mebibytes(x.memory_bytes),
            x.requests,
            x.refused,
        )
        for x in clients
    ]
    heads = ("CLIENT", "ACCOUNT", "CONNECTIONS", "LEASES", "SLOTS", "WAITING", "WAITING MIB", "UNREAD MIB", "SENT MIB")
    return answer_table(args, list(map(plain, clients)), rows, (*heads, "MEMORY MIB", "REQUESTS", "REFUSED"))


def _mebibytes(count: int) -> str:
    return f"{count / (1 << 20):.1f}" if count else "0"


def _compared(region: str, health: RegionHealth, offset_ns: int) -> str:
    """What the last check and those before it have found, in a sentence; `offset_ns`: CLOCK_REALTIME's."""
    at = time.strftime("%H:%M:%S", time.localtime((health.checked_ns + offset_ns) / 1e9))
    now = painted(f"{health.wrong_bits} bits are wrong", "red", sys.stdout) if health.wrong_bits else "good"
    last = f"{now} by the check at {at}" if health.checked_ns else "not compared since it was loaded"
    return f"{region}: {last}; {health.upsets} upsets found, {health.repairs} repairs"


def show(status: Status) -> None:
    """Print a status for people."""
    loaded = where(status) or "nothing loaded"
    going_on = painted(headline(status), _COLOURS[status.pr_mode.value], sys.stdout)
    print(f"{f'{status.board}: ' if status.board else ''}{loaded}   {going_on}")
    if status.last_error:
        what = "note" if status.last_error.code in NOTICES else "last error"
        mark = painted(f"{what}:", "yellow" if what == "note" else "red", sys.stdout)
        print(f"{mark} {status.last_error.code}: {status.last_error.message}")
    if status.regions:
        print()
        regions = [(r.name, r.module or "-", r.state) for r in status.regions]
        print_table(regions, ("REGION", "MODULE", "STATE"), _REGION_COLOURS)
        for region in status.regions:
            if region.health is not None and region.health.checks:
                print(_compared(region.name, region.health, status.realtime_offset_ns))
    if status.windows:
        print()
        mapped = [(f"{x.address:#x}", x.region, x.module or "-", window_use(x), x.client) for x in status.windows]
        print_table(mapped, ("WINDOW", "REGION", "MODULE", "HOW", "CLIENT"))
    if status.clocks:
        print()
        rates = [(c.name, _megahertz(c.wanted), _megahertz(c.rate) if c.rate else "not known") for c in status.clocks]
        print_table(rates, ("CLOCK", "WANTED MHZ", "RUNS AT MHZ"))
    if status.sensors:
        print()
        print(
            "  ".join(
                f"{s.name} {s.value:.{1 if s.quantity == 'temperature' else 2}f} {_UNITS.get(s.quantity, '')}".rstrip()
                for s in status.sensors
            )
        )
    if status.streams:
        print()
        rows = [
            (
                s.name,
                s.direction,
                "x".join(map(str, s.shape)) or "-",
                s.dtype,
                _flow(s.open, s.rate),
                s.frames,
                s.dropped,
            )
            for s in status.streams
        ]
        print_table(rows, ("STREAM", "DIRECTION", "SHAPE", "DTYPE", "FLOW", "FRAMES", "DROPPED"))


def _megahertz(rate: int) -> str:
    return f"{rate / 1e6:.6f}".rstrip("0").rstrip(".")


def headline(status: Status) -> str:
    """What is going on, in a few words."""
    if status.progress:
        p = status.progress
        goal = place(p.target_config, p.target_mode)
        return f"{status.pr_mode.value}: {goal}, {p.step} {p.subject} ({p.fraction:.0%})"
    return status.pr_mode.value


def _flow(is_open: bool, rate: float) -> str:
    return f"{rate:.1f}/s" if is_open else "closed"


_CLEAR = "\x1b[H\x1b[J"  # home, erase below: ECMA-48 CUP and ED


def add_watch(parser: argparse.ArgumentParser) -> None:
    """Add the command."""
    parser.description = (
        "Follow the status as it changes: a live view on a terminal, otherwise one line for each status."
    )
    add_board_options(parser, run_watch)
    parser.add_argument("--count", type=natural, default=0, metavar="N", help="stop after N statuses (0: never)")


def run_watch(args: argparse.Namespace) -> int:
    """Print each status until interrupted; the exit status."""
    once = args.count == 1  # then what was on the screen stays there
    live = sys.stdout.isatty() and (once or os.environ.get("TERM", "dumb") != "dumb")
    with connected(args) as board:
        for number, status in enumerate(followed(board, board.watch()), 1):
            if args.json:
                print_json(plain(status), lines=True)
            elif live:
                print("" if once else _CLEAR, end="")
                show(status)
                sys.stdout.flush()
            else:
                print(_line(status), flush=True)
            if number == args.count:
                break
    return 0


def _line(status: Status) -> str:
    loaded = where(status) or "-"
    error = f"  {status.last_error.code}: {status.last_error.message}" if status.last_error else ""
    return f"{status.sequence}  {loaded}  {headline(status)}{error}"
