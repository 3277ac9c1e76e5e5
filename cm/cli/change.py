# SPDX-License-Identifier: Apache-2.0
"""``cm load``, ``mode``, ``unload``, ``plan`` and ``cancel``: changes of mode. A mode is named ``[CONFIG/]MODE``."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

from cm.cli.common import Run, add_board_options, answer, completes, own_lease, print_json, print_table, slashed
from cm.cli.connection import connected, where
from cm.cli.failures import EXIT_INTERRUPTED
from cm.errors import CmError, Timeout
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import place

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.wire.messages.status import Status

_PATIENCE = 5.0  # seconds without a message from the manager, after which it is asked
_NO_MODE = ("unknown_mode", "nothing_loaded")


def add_load(parser: argparse.ArgumentParser) -> None:
    """Add ``cm load``."""
    parser.description = (
        "Go to a mode, as status prints it (camera/edge_detection), or to a configuration's default mode (camera)."
    )
    target = parser.add_argument("target", type=slashed, metavar="CONFIG[/MODE]", help="a configuration, and its mode")
    completes(target, "<config>", "<config/mode>")
    completes(parser.add_argument("mode", type=slashed, nargs="?", help=argparse.SUPPRESS), "<mode of target>")
    _add_options(parser, run_load)


def add_mode(parser: argparse.ArgumentParser) -> None:
    """Add ``cm mode``."""
    target = parser.add_argument(
        "target", type=slashed, metavar="[CONFIG/]MODE", help="a mode, or the module that exactly one mode consists of"
    )
    completes(target, "<mode>", "<config/mode>")
    _add_options(parser, run_mode)


def add_unload(parser: argparse.ArgumentParser) -> None:
    """Add ``cm unload``."""
    parser.description = (
        "Stop a region's streams, take its overlays off, and isolate it; no bitstream is loaded. The mode ends if it "
        "needs the region. The configuration stays; cm load or cm mode brings the region back."
    )
    completes(parser.add_argument("region", nargs="?", default="", metavar="REGION", help="default: all"), "<region>")
    add_board_options(parser, run_unload)


def add_plan(parser: argparse.ArgumentParser) -> None:
    """Add ``cm plan``."""
    target = parser.add_argument(
        "target", type=slashed, metavar="[CONFIG/]MODE", nargs="?", help="default: the configuration's default mode"
    )
    completes(target, "<mode>", "<config/mode>")
    completes(parser.add_argument("mode", type=slashed, nargs="?", help=argparse.SUPPRESS), "<mode of target>")
    completes(
        parser.add_argument(
            "--unload", nargs="?", const="*", default="", metavar="REGION", help="what cm unload would do instead"
        ),
        "<region>",
    )
    add_board_options(parser, run_plan)


def add_cancel(parser: argparse.ArgumentParser) -> None:
    """Add ``cm cancel``."""
    parser.description = (
        "Cancel the running change before its next load, and wait until the board is back"
        " in the previous mode. A change that has finished its last load is not "
        "cancelled; it completes."
    )
    add_board_options(parser, run_cancel)


def _add_options(parser: argparse.ArgumentParser, run: Run) -> None:
    """Add what `load` and `mode` share."""
    add_board_options(parser, run)
    parser.add_argument("--force", action="store_true", help="load it again even if it is loaded already")
    parser.add_argument("--no-wait", action="store_true", help="do not wait until it is done")


# ---- load and mode ---------------------------------------------------------------


def run_load(args: argparse.Namespace) -> int:
    """Go there; the exit status."""
    config, slash, mode = args.target.partition("/")
    with connected(args) as board:
        try:
            return _go(board, args, config, mode or args.mode or "")
        except CmError as error:
            if error.code != "unknown_config" or slash or args.mode or not _has_mode(board, config):
                raise
        return _go(board, args, "", config)


def run_mode(args: argparse.Namespace) -> int:
    """Go there; the exit status."""
    config, _, mode = args.target.rpartition("/")  # no configuration: the loaded one
    with connected(args) as board:
        try:
            return _go(board, args, config, mode)
        except CmError as error:
            if error.code in _NO_MODE and not config and mode in board.configs:
                error.args = (f"{error}; {mode} is a configuration: cm load {mode}",)
            raise


def _has_mode(board: Board, name: str) -> bool:
    """Whether the loaded configuration has a mode of that name."""
    loaded = board.status.config_name
    return bool(loaded) and name in {mode.name for mode in board.config(loaded).modes}


def _go(board: Board, args: argparse.Namespace, config: str, mode: str) -> int:
    """Ask for the mode and tell how it went."""
    if args.no_wait:
        change = board.load_async(config, mode, force=args.force, lease=own_lease())
        return answer(args, {"change": change.number, "done": False}, f"change {change.number} is under way")
    try:
        seconds = board.load(config, mode, progress=True, force=args.force, lease=own_lease())
    except KeyboardInterrupt:
        with suppress(CmError, KeyboardInterrupt):
            _interrupted(args, config, mode)
        return EXIT_INTERRUPTED
    status = board.status
    told = {"config_name": status.config_name, "mode": status.mode, "seconds": seconds, "done": True}
    return answer(args, told, f"{status.config_name}/{status.mode} after {seconds * 1000:.1f} ms")


def run_unload(args: argparse.Namespace) -> int:
    """Unload; the exit status."""
    with connected(args) as board:
        seconds = board.unload(args.region, lease=own_lease())
        status = board.status
    told = {"config_name": status.config_name, "mode": status.mode, "seconds": seconds, "done": True}
    return answer(args, told, f"{where(status)}, after {seconds * 1000:.1f} ms")


def _interrupted(args: argparse.Namespace, config: str, mode: str) -> None:
    """Say what becomes of the change that nobody waits for any more. A connection of its own asks."""
    with connected(args) as board:
        status = board.status
        if status.progress is None:
            _say(f"no change is running; the board is in {_reached(status)}")
        elif not _is_ours(board, status, config, mode):
            _say(f"the change waits until the one to {_target(status)} has ended, and goes on then")
        else:
            _say(f"the change to {_target(status)} goes on; `cm cancel` takes it back, `cm watch` shows it")


def _is_ours(board: Board, status: Status, config: str, mode: str) -> bool:
    """Whether the running change is the one that we asked for, by its name; others wait behind it."""
    running = status.progress
    if running is None or config not in ("", running.target_config):
        return False
    modes = {known.name for known in board.config(running.target_config).modes}
    return mode in ("", running.target_mode) or mode not in modes  # a module's name stands for a mode


def _target(status: Status) -> str:
    goal = status.progress
    return place(goal.target_config, goal.target_mode) if goal else ""


def _say(sentence: str) -> None:
    print(f"cm: {sentence}", file=sys.stderr, flush=True)


# ---- plan ------------------------------------------------------------------------


def run_plan(args: argparse.Namespace) -> int:
    """Print the steps; the exit status."""
    config, mode = (args.target, args.mode) if args.mode else (args.target or "").rpartition("/")[::2]
    with connected(args) as board:
        try:
            plan = board.plan(mode, config, unload=args.unload)
        except CmError as error:
            if error.code not in _NO_MODE or config or mode not in board.configs:
                raise
            plan = board.plan("", mode)
    if args.json:
        print_json(plain(plan))
        return 0
    goal = place(plan.config_name, plan.mode)
    if not plan.steps:
        there = "it is unloaded already" if args.unload else "the board is already in this mode"
        print(f"{goal}: nothing to do, {there}")
        return 0
    rows = [
        (i, s.text, s.bytes or "", f"{s.seconds * 1000:.2f}" if s.seconds else "") for i, s in enumerate(plan.steps, 1)
    ]
    print_table(rows, ("", "STEP", "BYTES", "MS"))
    print(f"{goal}: {plan.bytes} bytes to load, about {plan.seconds * 1000:.1f} ms")
    return 0


# ---- cancel ----------------------------------------------------------------------


def run_cancel(args: argparse.Namespace) -> int:
    """Cancel and tell where the board is; the exit status."""
    with connected(args) as board:
        change, status = _cancelled(board)
    told = {"config_name": status.config_name, "mode": status.mode}
    cancelled = bool(change) and _was_cancelled(status)
    return answer(args, {"change": change, "cancelled": cancelled, **told}, _told(change, status))


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


def _told(change: int, status: Status) -> str:
    if not change:
        there = where(status)
        return f"no change is running; {f'the board is in {there}' if there else 'nothing is loaded'}"
    how = "was cancelled" if _was_cancelled(status) else "had ended before"
    return f"change {change} {how}; the board is at {_reached(status)}"


def _was_cancelled(status: Status) -> bool:
    return status.last_error is not None and status.last_error.code == "cancelled"


def _reached(status: Status) -> str:
    return where(status) or "nothing loaded"
