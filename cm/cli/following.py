# SPDX-License-Identifier: Apache-2.0
"""Events until the user stops; if the manager goes away, says so and waits for it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeVar

from cm.errors import CmError, Timeout

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.client.events import EventStream

_T = TypeVar("_T")
_QUIET = 1.0  # seconds without an event after which the manager is asked whether it is there
_PATIENCE = 3.0  # seconds for its answer


def followed(board: Board, events: EventStream[_T]) -> Iterator[_T]:
    """Each event. On standard error it says once that the manager does not answer, and once that it does again.

    ZeroMQ reconnects and subscribes again silently, so a manager that has gone looks like one that has nothing to say.
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
