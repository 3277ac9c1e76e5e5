# SPDX-License-Identifier: Apache-2.0
"""How commands reach a manager, follow what it tells, and show its answers."""

from __future__ import annotations

import argparse
import select
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, TypeVar

from cm.errors import CmError, NotFound, Timeout

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.client.events import EventStream
    from cm.wire.messages.status import Status, WindowStatus

_PAUSE = 0.1  # seconds between two tries


def connected(args: argparse.Namespace, timeout: float = 5.0) -> Board:
    """The manager that ``--runtime-dir`` or ``--connect`` names, or this machine's; `timeout` in seconds.

    Raises what `connect` does; NoAnswer says so where the host's name does not resolve, or the host refuses.
    """
    from cm.client.board import connect  # here: a completed name or a help text needs no client
    from cm.client.errors import NoAnswer

    try:
        return connect(args.connect, runtime_dir=args.runtime_dir, timeout=timeout, keys=args.keys)
    except NoAnswer as error:
        from cm.client.find_manager import find, unreached

        why = unreached(find(args.connect, args.runtime_dir, args.keys).endpoints.pub)
        if why:
            raise NoAnswer(f"{error}: {why}") from None
        raise


def awaited(args: argparse.Namespace, seconds: float) -> Board:
    """The same, tried until one answers. Raises what the last try raised after `seconds`."""
    end = time.monotonic() + seconds
    while True:
        try:
            return connected(args)
        except (NotFound, Timeout):
            if time.monotonic() > end:
                raise
            time.sleep(_PAUSE)


def settled(board: Board, seconds: float) -> Status:
    """The first status that tells of no change under way. Raises Timeout after `seconds` without a new one."""
    with board.watch(timeout=seconds) as statuses:
        return next(status for status in statuses if not status.fpga_busy)


def where(status: Status) -> str:
    """The mode that the board is in, or the configuration where it is in none; empty if nothing is loaded."""
    if not status.mode:  # a change failed, and so did its way back
        return f"{status.config_name}, in no mode" if status.config_name else ""
    return f"{status.config_name}/{status.mode}"


def window_use(window: WindowStatus) -> str:
    """What the holder of a window may do there."""
    return "alone" if window.exclusive else "writes" if window.writes else "reads"


_T = TypeVar("_T")
_QUIET = 1.0  # seconds without an event after which the manager is asked whether it is there
_PATIENCE = 3.0  # seconds for its answer


def followed(board: Board, events: EventStream[_T]) -> Iterator[_T]:
    """Each event. On standard error it says once that the manager does not answer, and once that it does again.

    ZeroMQ reconnects and subscribes again silently, so a manager that has gone looks like one that has nothing to say.
    Raises BrokenPipeError where the reader of our output has gone: the next event, which would show it, may never come.
    """
    answers = True
    with events:
        while True:
            event = _next(events)
            before, answers = answers, event is not None or _answers(board)
            if answers != before:
                _say("the manager answers again" if answers else "the manager does not answer; waiting for it")
            if event is not None:
                yield event
            else:
                check_reader()


def check_reader() -> None:
    """Raise BrokenPipeError if standard output is a pipe that nobody reads any more."""
    if sys.platform == "win32":
        return
    out = select.poll()
    with suppress(AttributeError, OSError, ValueError):  # closed by the shell, or no file at all
        out.register(sys.stdout.fileno(), 0)
    if any(event & select.POLLERR for _, event in out.poll(0)):
        raise BrokenPipeError


def _next(events: EventStream[_T]) -> _T | None:
    try:
        return events.next(_QUIET)
    except Timeout:
        return None


def _answers(board: Board) -> bool:
    from cm.client.core import calls
    from cm.client.errors import ConnectionLost

    try:
        board.ask(calls.status(), timeout=_PATIENCE)
    except (Timeout, ConnectionLost):
        return False
    except CmError:  # a refusal is an answer
        pass
    return True


def _say(words: str) -> None:
    print(f"cm: {words}", file=sys.stderr, flush=True)
