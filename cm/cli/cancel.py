# SPDX-License-Identifier: Apache-2.0
"""``cm cancel``: cancel the running change; the board goes back to the previous mode."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cm.cli.client import connected
from cm.cli.common import add_connection_options, add_json_option, print_json
from cm.errors import Timeout
from cm.wire.messages.status import Status

if TYPE_CHECKING:
    from cm.client.board import Board

_PATIENCE = 5.0  # seconds without a message from the manager, after which it is asked


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "cancel",
        help="cancel the running change",
        description="Cancel the running change before its next load, and wait until the board is back"
        " in the previous mode. A change that has finished its last load is not "
        "cancelled; it completes.",
    )
    add_connection_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Cancel and tell where the board is; the exit status."""
    with connected(args) as board:
        under_way, status = _cancelled(board)
    reached = f"{status.config_name}/{status.mode}" if status.config_name else "nothing loaded"
    cancelled = status.last_error is not None and status.last_error.code == "cancelled"
    if args.json:
        told = {"config_name": status.config_name, "mode": status.mode}
        print_json({"change": under_way, "cancelled": cancelled and bool(under_way), **told})
    elif not under_way:
        print(f"no change is running; the board is in {reached}")
    elif cancelled:
        print(f"change {under_way} was cancelled; the board is at {reached}")
    else:
        print(f"change {under_way} had ended before; the board is at {reached}")
    return 0


def _cancelled(board: Board) -> tuple[int, Status]:
    """The change that was asked to end (0: none ran), and the status after its end."""
    with board.watch() as statuses:  # begins with the status now
        status = statuses.next()
        if status.progress is None:
            return 0, status
        change = status.progress.change
        board.cancel()
        while status.last_change < change:
            try:
                status = statuses.next(_PATIENCE)
            except Timeout:
                status = board.status  # raises where the manager has gone
    return change, status
