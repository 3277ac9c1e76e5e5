# SPDX-License-Identifier: Apache-2.0
"""Messages as JSON (protobuf's own mapping, with the names of cm.proto) for clients without protobuf."""

from __future__ import annotations

from google.protobuf import json_format
from google.protobuf.message import Message

from cm.errors import InvalidRequest
from cm.wire import cm_pb2 as pb
from cm.wire.encode import parsed


def kinds() -> frozenset[str]:
    """Names of all messages of cm.proto."""
    return frozenset(pb.DESCRIPTOR.message_types_by_name)


def to_json(kind: str, data: bytes) -> str:
    """A serialised message of the named kind, such as "Status", as JSON. Raises InvalidRequest."""
    message = parsed(getattr(pb, kind), data)
    return json_format.MessageToJson(message, preserving_proto_field_name=True, indent=None)


def from_json(kind: str, text: str | bytes) -> bytes:
    """JSON as a serialised message. Raises InvalidRequest that says which field is wrong."""
    message: Message = getattr(pb, kind)()
    try:
        json_format.Parse(text, message)
    except (json_format.ParseError, UnicodeDecodeError) as problem:
        raise InvalidRequest(f"{kind} as JSON: {problem}") from problem
    return message.SerializeToString()
