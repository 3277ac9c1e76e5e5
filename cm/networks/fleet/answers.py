# SPDX-License-Identifier: Apache-2.0
"""Boards' answers in the form in which the client returns them: data, or a board's error."""

from __future__ import annotations

from cm.errors import CmError, InvalidRequest
from cm.networks.fleet.asking import Answer
from cm.wire import fleet as wire
from cm.wire.encode import decode_reply
from cm.wire.messages.fleet import BundleState, FleetRecord
from cm.wire.messages.status import ErrorInfo, RegValues


def registers(answer: Answer) -> RegValues | ErrorInfo:
    """Values that were read back, or the refusal."""
    if answer.error is not None:
        return answer.error
    reply = decode_reply([b"", answer.payload])
    if reply.error is not None:
        return reply.error
    return reply.body if isinstance(reply.body, RegValues) else ErrorInfo("network", "no registers came back")


def record(answer: Answer) -> FleetRecord | ErrorInfo:
    """The answer to a step of a change."""
    if answer.error is not None:
        return answer.error
    try:
        found = wire.decode_answer(answer.payload)
    except InvalidRequest as error:
        return ErrorInfo(error.code, str(error))
    return found if isinstance(found, (FleetRecord, ErrorInfo)) else ErrorInfo("network", "no record came back")


def bundle(answer: Answer) -> BundleState | ErrorInfo:
    """How much of an archive has arrived."""
    if answer.error is not None:
        return answer.error
    try:
        found = wire.decode_answer(answer.payload)
    except CmError as error:
        return ErrorInfo(error.code, str(error))
    return found if isinstance(found, (BundleState, ErrorInfo)) else ErrorInfo("network", "no bundle came back")


def named(board: str, error: ErrorInfo) -> ErrorInfo:
    """The error with its board in the sentence, for where nothing else names it."""
    return ErrorInfo(error.code, f"{board}: {error.message}")
