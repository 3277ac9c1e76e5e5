# SPDX-License-Identifier: Apache-2.0
"""Frames → frozen requests: the server's reading side of the protocol."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from cm.errors import InvalidRequest
from cm.wire import bounds, parse, text, topics
from cm.wire.messages import requests as rq
from cm.wire.request_table import BY_TOPIC, Frame, row_of

TOPICS = frozenset({*BY_TOPIC, topics.TEXT_CONFIG})  # of commands
_SHORT, _KEPT = 256, 256  # bytes of the longest message whose request is kept, and how many are kept


def split_text(frames: Sequence[Frame]) -> list[Frame]:
    """``[b"cm_config edge"]`` → ``[b"cm_config", b"edge"]``: the paper's one-frame spelling."""
    if len(frames) == 1:
        topic, space, rest = bytes(frames[0]).partition(b" ")
        if space:
            return [topic, rest]
    return list(frames)


def decode_request(frames: Sequence[Frame]) -> rq.Request:
    """``[topic][message][payload…]`` → the request. Raises InvalidRequest, never anything else."""
    if len(frames) == 2 and len(frames[1]) <= _SHORT:
        return _decode_again(bytes(frames[0]), bytes(frames[1]))
    parts = split_text(frames)
    if not parts:
        raise InvalidRequest("an empty message; frames are [topic][message][payload…]")
    return _decode(bytes(parts[0]), bytes(parts[1]) if len(parts) > 1 else b"", parts[2:])


@lru_cache(_KEPT)
def _decode_again(topic: bytes, message: bytes) -> rq.Request:
    """Clients repeat requests for a register or the status byte for byte, so decoded ones are kept; they are frozen."""
    return _decode(topic, message, ())


def _decode(topic: bytes, message: bytes, payload: Sequence[Frame]) -> rq.Request:
    if topic not in TOPICS:
        known = ", ".join(sorted(t.decode() for t in TOPICS))
        raise InvalidRequest(f"unknown topic {topic[:64].decode('utf-8', 'backslashreplace')!r}; topics are {known}")
    if topic == topics.WRITE_REG:  # long ones are read in slices (`cm.wire.parse`)
        _no_payload(topic, payload)
        return bounds.in_one_go(parse.writes(message))
    if topic == topics.TEXT_CONFIG or (topic == topics.WRITE_CONFIG and text.is_word(message)):
        _no_payload(topic, payload)
        return text.parse_config(message)
    parsed = parse.parse(BY_TOPIC[topic][0].message, topic.decode(), message)
    request: rq.Request = row_of(topic, parsed).decode(parsed, payload)
    return request


def _no_payload(topic: bytes, payload: Sequence[Frame]) -> None:
    if payload:
        raise InvalidRequest(f"{topic.decode()}: {len(payload)} payload frames where none is expected")
