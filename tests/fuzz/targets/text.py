# SPDX-License-Identifier: Apache-2.0
"""The paper's plain-text spellings: a request, or InvalidRequest."""

from __future__ import annotations

from contextlib import suppress

from cm.errors import InvalidRequest
from cm.wire import bounds
from cm.wire.text import in_slices, is_mapping, is_word, parse_config

PACKAGES = ("cm.wire.text",)
MAX_LENGTH = 70_000  # a little more than is read


def seeds() -> list[bytes]:
    return [
        b"edge",
        b"camera/edge_detection",
        b"{ 'focus':0x2}",
        b'{"focus": 2, "zoom": true}',
        b"{'a': 1_000, 'b': 0b1}",
    ]


def one(data: bytes) -> None:
    with suppress(InvalidRequest):
        assert parse_config(data).mode or is_word(data)
    with suppress(InvalidRequest):
        request = bounds.in_one_go(in_slices(data))
        assert all(isinstance(write.value, int) for write in request.writes)
        assert is_mapping(data) or not data.lstrip().startswith(b"{")
