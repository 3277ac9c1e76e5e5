# SPDX-License-Identifier: Apache-2.0
"""Bytes → messages that are within bounds; and long requests in slices, so that others are served in between."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

from google.protobuf.message import DecodeError, Message

from cm.errors import InvalidRequest
from cm.wire import bounds, text
from cm.wire import cm_pb2 as pb
from cm.wire.messages.requests import RegWrite, WriteReg

LONG = 1024  # bytes of writes of registers that take more than a moment to read
_Message = TypeVar("_Message", bound=Message)


def parse(message_type: type[_Message], topic: str, payload: bytes) -> _Message:
    """A message. Raises InvalidRequest, also for what is in it and beyond `bounds`."""
    message = _parsed(message_type, topic, payload)
    bounds.check(topic, message, len(payload))
    return message


def _parsed(message_type: type[_Message], topic: str, payload: bytes) -> _Message:
    """What is in it was not looked at."""
    bounds.check_length(topic, payload, schema=message_type is pb.WriteConfig)
    try:
        return message_type.FromString(payload)
    except DecodeError as error:
        raise InvalidRequest(f"{topic}: the second frame is not a {message_type.__name__} message ({error})") from error


def writes(message: bytes) -> Generator[None, None, WriteReg]:
    """A request to write registers, some with each `next`: a message, or plain text. Raises InvalidRequest."""
    return text.in_slices(message) if text.is_mapping(message) else _in_slices(message)


def _in_slices(message: bytes) -> Generator[None, None, WriteReg]:
    m = _parsed(pb.WriteReg, "cm_write_reg", message)
    bounds.check_count("cm_write_reg", "writes", len(m.writes))
    made: list[RegWrite] = []
    for w in m.writes:
        bounds.check("cm_write_reg", w, len(message))
        made.append(RegWrite(w.name, w.value, mask=w.mask if w.HasField("mask") else None, named=w.named))
        if len(made) % bounds.SLICE == 0:
            yield
    if not made:
        raise InvalidRequest("cm_write_reg: no register is named; writes must hold at least one")
    bounds.check_text("cm_write_reg", "lease", m.lease)
    return WriteReg(tuple(made), m.lease)
