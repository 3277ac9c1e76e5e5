# SPDX-License-Identifier: Apache-2.0
"""Queries over zenoh, awaited; answers and errors, each with its board."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any, TypeVar

from cm.errors import CmError, InvalidRequest
from cm.networks.fleet import keys
from cm.networks.fleet.zenoh_session import in_loop, zenoh_module
from cm.wire import fleet as wire
from cm.wire.messages.status import ErrorInfo

AWAY = ErrorInfo("no_answer", "it is not in the fleet now")
SILENT = ErrorInfo(  # a denied query looks like an absent board, so this says what can be told apart
    "no_answer", "it is in the fleet but did not answer: it hangs, is too slow, or the router's rules keep us off"
)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a board answered: a message, or data with the message beside it; or an error."""

    board: str
    payload: bytes = b""
    attachment: bytes = b""
    error: ErrorInfo | None = None


async def answers(
    session: Any, selector: str, payload: bytes = b"", attachment: bytes | None = None, timeout: float = 10.0
) -> AsyncIterator[Answer]:
    """Those to a query, as they come, until all boards have answered or gone, or the time (seconds) is over."""
    zenoh, come = zenoh_module(), asyncio.Queue[Answer | None]()
    tell = in_loop(come.put_nowait)
    handler = zenoh.handlers.Callback(  # in zenoh's own thread: a thread for each query costs more than the query
        lambda reply: tell(_answer(reply)), lambda: tell(None), indirect=False
    )
    session.get(
        selector,
        handler,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        payload=payload or None,
        attachment=attachment,
        timeout=timeout,
    )
    while (answer := await come.get()) is not None:
        if answer.error is None or answer.error.message != "Timeout":
            yield answer


def _answer(reply: Any) -> Answer:
    if reply.ok is not None:
        attachment = bytes(reply.ok.attachment) if reply.ok.attachment is not None else b""
        return Answer(keys.board_of(str(reply.ok.key_expr)), bytes(reply.ok.payload), attachment)
    data = bytes(reply.err.payload)
    try:
        error = wire.body(data)
    except InvalidRequest:
        error = ErrorInfo("network", data.decode("utf-8", "replace"))
    if not isinstance(error, ErrorInfo):
        error = ErrorInfo("network", "an error without a reason")
    board, colon, message = error.message.partition(": ")
    return Answer(board, error=ErrorInfo(error.code, message) if colon else error)


_Body = TypeVar("_Body")


def said(answer: Answer, kind: type[_Body]) -> _Body | ErrorInfo:
    """The body of a Reply, or the refusal."""
    if answer.error is not None:
        return answer.error
    try:
        found = wire.decode_answer(answer.payload)
    except CmError as error:
        return ErrorInfo(error.code, str(error))
    return found if isinstance(found, (kind, ErrorInfo)) else ErrorInfo("network", f"no {kind.__name__} came back")
