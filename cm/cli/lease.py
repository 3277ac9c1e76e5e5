# SPDX-License-Identifier: Apache-2.0
"""``cm lease take|give|list|break``: hold part of the board, and see who holds what."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from cm.cli.common import add_board_options, answer, answer_table, completes, seconds
from cm.cli.connection import connected, window_use
from cm.cli.parser import Parser
from cm.client.core import calls, leases
from cm.errors import CmError, NotFound
from cm.home import account
from cm.wire.messages.json_values import plain
from cm.wire.messages.requests import TakeLease

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.client.lease import BoardLease

_HELD = 30.0  # seconds for which a lease is taken, and renewed three times in that time
_VARIABLE = "CM_LEASE"


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=_Parser)
    taking = actions.add_parser(
        "take",
        usage="%(prog)s SCOPE [--seconds N | -- COMMAND ...]",
        help="hold part of the board",
        description="Hold part of the board, so that others cannot change it: while COMMAND runs (behind --, with "
        "the lease's id in $CM_LEASE, which `cm` passes on), or until Ctrl-C. With --seconds, print the id and end: "
        "export CM_LEASE=$(cm lease take board --seconds 600). If cm is killed (SIGKILL), COMMAND goes on without the "
        "lease, unless it begins with setpriv(1) (docs/cli.md).",
    )
    scope = taking.add_argument(
        "scope", metavar="SCOPE", help="board, config, region:NAME, registers:NAME or memories:NAME"
    )
    completes(scope, "board", "config", "region:", "registers:", "memories:")
    taking.add_argument("--seconds", type=seconds, metavar="N", help="take it for so long, at most 3600, and end")
    add_board_options(taking, run_take)
    taking.set_defaults(refuse=taking.error, command=[])
    giving = actions.add_parser("give", help="give a lease back")
    giving.add_argument(
        "id", metavar="ID", nargs="?", default=os.environ.get(_VARIABLE, ""), help="its id (default: $CM_LEASE)"
    )
    add_board_options(giving, run_give)
    giving.set_defaults(refuse=giving.error)
    listing = actions.add_parser("list", help="list the leases and windows, who holds them and for how long")
    add_board_options(listing, run_list)
    breaking = actions.add_parser("break", help="end somebody else's lease (for administrators)")
    breaking.add_argument("number", metavar="NUMBER", type=int, help="number of the lease in the list")
    add_board_options(breaking, run_break)


class _Parser(Parser):
    """Keeps what follows -- as `command`, where there is one; argparse mistakes it for arguments behind options."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """As argparse's."""
        words = list(args)
        at = words.index("--") if "--" in words and self.get_default("command") is not None else len(words)
        known, left = super().parse_known_args(words[:at], namespace)
        if words[at + 1 :]:
            known.command = words[at + 1 :]
        return known, left


def run_take(args: argparse.Namespace) -> int:
    """Hold it; the exit status, that of COMMAND if there is one."""
    if args.seconds is not None and args.command:
        args.refuse("--seconds: with a COMMAND, the lease is held for as long as that runs")
    holder = account(f"pid {os.getpid()}")
    with connected(args) as board:
        if args.seconds is not None:
            return _leave(board, args, holder)
        lease = board.lease(args.scope, seconds=_HELD, holder=holder)
        lease.take()
        try:
            if args.command:
                return _during(args.command, lease)
            told = {"id": lease.id, "scope": args.scope, "seconds": _HELD}
            answer(args, told, f"{lease.id} holds {args.scope} until Ctrl-C", lines=True)
            while True:
                time.sleep(_HELD / 3)
                lease.renew()
        finally:
            with suppress(CmError):  # somebody broke it, or the manager went away
                lease.release()


def _leave(board: Board, args: argparse.Namespace, holder: str) -> int:
    """Take it for some time; it does not end with this process."""
    taken = board.ask(calls.lease(TakeLease(args.scope, True, seconds=args.seconds, holder=holder)))
    return answer(args, {"id": taken.id, "scope": args.scope, "seconds": taken.seconds}, taken.id, lines=True)


def _during(command: list[str], lease: BoardLease) -> int:
    """Run `command` and renew the lease until it ends; its exit status, as a shell would give it."""
    kept = True
    with _started(command, {**os.environ, _VARIABLE: lease.id}) as process:
        while True:
            try:
                status = process.wait(_HELD / 3)
            except subprocess.TimeoutExpired:
                kept = kept and _renewed(lease)
            except KeyboardInterrupt:  # of the terminal, which has told the command too
                continue
            else:
                return status if status >= 0 else 128 - status


@contextmanager
def _started(command: list[str], variables: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    """Start it. Signals that would end us are for it: it would go on without the lease, beside the next holder."""
    there = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has one
    numbers = [number for number in there if signal.getsignal(number) is signal.SIG_DFL]  # nohup ignores the other
    early: list[int] = []
    take: Callable[[int], None] = early.append
    for number in numbers:
        signal.signal(number, lambda n, _: take(n))
    try:
        with subprocess.Popen(command, env=variables) as process:
            take = process.send_signal
            for number in early:
                process.send_signal(number)
            yield process
    except FileNotFoundError:
        raise NotFound(f"no command {command[0]!r}") from None
    finally:
        for number in numbers:
            signal.signal(number, signal.SIG_DFL)


def _renewed(lease: BoardLease) -> bool:
    """Whether it is still held; if not, says so, and lets the command decide."""
    try:
        lease.renew()
    except CmError as error:
        print(f"cm: the lease is not held any more: {error}", file=sys.stderr, flush=True)
        return False
    return True


def run_give(args: argparse.Namespace) -> int:
    """Give it back; the exit status."""
    if not args.id:
        args.refuse("which lease? ID, or CM_LEASE=ID")
    with connected(args) as board:
        given = board.ask(calls.lease(leases.release(args.id)))
    return answer(args, plain(given), f"{given.scope} is given back")


def run_list(args: argparse.Namespace) -> int:
    """Print the leases; the exit status."""
    with connected(args) as board:
        status = board.status
    held, windows = status.leases, status.windows
    mapped = [{"scope": f"window:{x.region}", **x._asdict()} for x in windows]
    rows: list[tuple[object, ...]] = [
        (x.number, x.scope, "alone" if x.exclusive else "shared", x.holder, x.client, f"{x.seconds:.0f} s")
        for x in held
    ]
    rows += [("-", f"window:{x.region}", window_use(x), x.module or "-", x.client, "-") for x in windows]
    headers = ("NUMBER", "SCOPE", "HOW", "HOLDER", "CLIENT", "LEFT")
    return answer_table(args, [*map(plain, held), *mapped], rows, headers)


def run_break(args: argparse.Namespace) -> int:
    """End a lease; the exit status."""
    with connected(args) as board:
        ended = board.break_lease(args.number)
    return answer(args, plain(ended), f"{ended.scope} is held no more by {ended.holder}")
