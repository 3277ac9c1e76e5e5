# SPDX-License-Identifier: Apache-2.0
"""Long writes of registers are decoded in slices of a few entries, with the same result as all at once."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.errors import InvalidRequest
from cm.wire import bounds, parse, text
from cm.wire import cm_pb2 as pb
from cm.wire.decode import decode_request
from cm.wire.messages.requests import RegWrite, WriteReg

TOPIC = b"cm_write_reg"


def message(count: int, lease: str = "", **last: Any) -> bytes:
    """`count` writes, the last of which differs."""
    writes = [pb.RegWrite(name=f"r{number}", value=number) for number in range(count)]
    if last:
        writes[-1] = pb.RegWrite(**last)
    return pb.WriteReg(writes=writes, lease=lease).SerializeToString()


def mapping(count: int, last: str = "") -> bytes:
    entries = [f"'r{number}': {number}" for number in range(count)]
    return "{{{}}}".format(", ".join([*entries, last] if last else entries)).encode()


def read(data: bytes) -> tuple[list[WriteReg | InvalidRequest], int]:
    """Return the result, and the number of slices."""
    steps, slices = parse.writes(data), 0
    while True:
        try:
            next(steps)
            slices += 1
        except StopIteration as end:
            return [end.value], slices
        except InvalidRequest as error:
            return [error], slices


def at_once(data: bytes) -> WriteReg | InvalidRequest:
    try:
        return decode_request([TOPIC, data])  # type: ignore[return-value]
    except InvalidRequest as error:
        return error


@pytest.mark.parametrize("data", [message(1024), mapping(1024)], ids=["message", "mapping"])
def test_1024_writes_are_read_64_at_a_time(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = [0]

    def counted(*arguments: Any, **named: Any) -> RegWrite:
        made[-1] += 1
        return RegWrite(*arguments, **named)

    monkeypatch.setattr(parse, "RegWrite", counted)
    monkeypatch.setattr(text, "RegWrite", counted)
    steps, came = parse.writes(data), None
    while came is None:
        try:
            next(steps)
            made.append(0)
        except StopIteration as end:
            came = end.value
    assert max(made) == bounds.SLICE == 64
    assert sum(made) == 1024
    assert [came] == [WriteReg(tuple(RegWrite(f"r{number}", number) for number in range(1024)))]


WRONG = [
    message(0),
    message(1025),
    message(1024, name="n" * 257),
    message(1024, name="a", named="n" * 257),
    message(600, lease="l" * 5000),
    message(1000)[:-1],
    b"\xff" * 2000,
    mapping(1025),
    mapping(1000, "'a': 0x" + "f" * 17),
    mapping(1000, f"'{'n' * 257}': 1"),
    mapping(1000, "'a': '1'"),
    mapping(1000, "a: 1"),
    mapping(1000) + b"}",
    mapping(1000)[:-1],
    b"{" + b" " * 60_000 + b"'a' 1}",
    b"{'a'" + b" " * 60_000 + b"1}",
    mapping(1000) + b" " * 130_000,
    b"{" * 60_000,
    b"{'a': 1, '\xff': 1}",
]


@pytest.mark.parametrize("data", WRONG, ids=range(len(WRONG)))
def test_errors_are_the_same_as_if_it_were_read_at_once(data: bytes) -> None:
    (came,), _ = read(data)
    expected = at_once(data)
    assert isinstance(came, InvalidRequest)
    assert (type(came), str(came)) == (type(expected), str(expected))


@given(st.lists(st.sampled_from(["'a': 1", "'b':0x2 ", '"c.d":true', "'e': x", "f: 1", "", "'g'}"]), max_size=300))
def test_any_mapping_is_read_as_at_once(entries: list[str]) -> None:
    data = "{{{}}}".format(",".join(entries)).encode()
    (came,), slices = read(data)
    expected = at_once(data)
    assert str(came) == str(expected)
    assert slices <= len(entries) // bounds.SLICE + 1


@given(st.integers(0, 300), st.sampled_from([{}, {"name": "n" * 257}, {"name": "m", "mask": 3, "value": 1}]))
def test_any_message_is_read_as_at_once(count: int, last: dict[str, Any]) -> None:
    data = message(count + 1, **last)
    (came,), slices = read(data)
    assert str(came) == str(at_once(data))
    assert slices == (count + (not last or len(last) == 3)) // bounds.SLICE
