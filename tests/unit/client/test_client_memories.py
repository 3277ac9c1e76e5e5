# SPDX-License-Identifier: Apache-2.0
"""Items of a memory are those of the array that it holds, whatever has to be asked for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cm.client.core.calls import Call
from cm.client.core.flow_effects import Flow
from cm.client.memories import Memory
from cm.errors import InvalidRequest
from cm.wire.messages import requests as rq
from cm.wire.messages.status import FrameInfo, MemoryInfo, Reply

WHOLE = 4 << 20  # what a manager takes in one message


class Held:
    """Asked instead of a board: whole words of one memory, no more than a message may have."""

    def __init__(self, dtype: str, shape: tuple[int, ...], described: bool = True) -> None:
        self.values = np.random.default_rng(1).integers(0, 100, shape).astype(dtype)
        self.info = MemoryInfo("table", 0x1000, self.values.nbytes, "rw", dtype, shape if described else ())
        self.asked: list[rq.Request] = []
        self.memory = Memory(self, "table")  # type: ignore[arg-type]

    def ask(self, call: Call[Any], timeout: Any = None) -> Any:
        request: Any = call.request
        self.asked.append(request)
        if isinstance(request, rq.DescribeData):
            return call.result(Reply(self.info))
        length = len(request.data) if isinstance(request, rq.WriteData) else request.length
        assert request.offset % 4 == length % 4 == 0
        assert 0 < length <= WHOLE
        held = self.values.reshape(-1).view(np.uint8)[request.offset : request.offset + length]
        assert len(held) == length
        info = FrameInfo("table", 0, 0, length, (length,))
        if isinstance(request, rq.WriteData):
            held[:] = np.frombuffer(request.data, np.uint8)
            return call.result(Reply(info))
        if length == self.info.size:
            info = replace(info, shape=self.values.shape, dtype=self.info.dtype)
        return call.result(Reply(info, payload=(held.tobytes(),)))

    def run(self, flow: Flow[Any]) -> Any:
        answer = None
        while True:
            try:
                answer = self.ask(flow.send(answer))
            except StopIteration as end:
                return end.value


SHAPES: list[tuple[str, tuple[int, ...]]] = [("int16", (8, 6)), ("uint8", (4, 3)), ("uint8", (21, 4)), ("<f4", (16,))]


@pytest.mark.parametrize(("dtype", "shape"), SHAPES)
@pytest.mark.parametrize("key", [0, 3, -1, slice(1, 3), slice(None), slice(2, None), slice(-2, None), slice(3, 1)])
def test_items_are_read_with_the_words_around_them_and_no_others(
    dtype: str, shape: tuple[int, ...], key: int | slice
) -> None:
    held = Held(dtype, shape)
    item, expected = held.memory[key], held.values[key]
    assert (item.dtype, item.shape) == (expected.dtype, expected.shape)
    assert np.array_equal(item, expected)
    read = sum(request.length or 0 for request in held.asked if isinstance(request, rq.ReadData))
    assert read < expected.nbytes + 7
    assert len(held.memory) == shape[0]


def test_a_memory_is_an_array_where_one_is_wanted() -> None:
    held = Held("int16", (8, 6))
    assert np.array_equal(np.asarray(held.memory), held.values)
    assert np.asarray(held.memory, "float32").dtype == np.float32
    assert np.array_equal([row.tolist() for row in held.memory], held.values)
    with pytest.raises(ValueError, match=r"^memory 'table' cannot be had without a copy$"):
        held.memory.__array__(copy=False)


@pytest.mark.parametrize(
    ("dtype", "shape", "key", "given"),
    [
        ("int16", (8, 6), 2, [1, 2, 3, 4, 5, -6]),
        ("int16", (8, 6), slice(2, 5), 7),
        ("int16", (8, 6), slice(2, 4), [[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 12]]),
        ("int16", (8, 6), slice(4, 4), 7),
        ("uint8", (21, 4), -1, [1, 2, 3, 4]),
        ("uint8", (8, 3), slice(4, 8), 5),
        ("<f4", (16,), slice(14, None), [1.5, 2.5]),
        ("<f4", (16,), 3, 1),
        ("uint32", (16,), -1, 7),
    ],
)
def test_items_are_written_and_all_else_stays(dtype: str, shape: tuple[int, ...], key: int | slice, given: Any) -> None:
    held = Held(dtype, shape)
    expected = held.values.copy()
    expected[key] = given
    held.memory.put(key, given, "mine")
    assert np.array_equal(held.values, expected)
    assert {request.lease for request in held.asked if isinstance(request, rq.WriteData)} <= {"mine"}
    held.memory[key] = 0
    expected[key] = 0
    assert np.array_equal(held.values, expected)


@pytest.mark.parametrize(
    ("key", "given", "kind", "words"),
    [
        (8, 0, IndexError, r"memory 'table': index 8 of 8"),
        (-9, 0, IndexError, r"memory 'table': index -9 of 8"),
        (slice(0, 8, 2), 0, InvalidRequest, "a step of 2; slices of memories have none"),
        (1, 0, InvalidRequest, "whole words, so begin and end at multiples of 4"),
        (slice(0, 6), 0, InvalidRequest, "whole words, so begin and end at multiples of 4"),
        (slice(4, 8), [1, 2], InvalidRequest, r"memory 'table': \(2,\) for \(4, 3\): .*broadcast"),
    ],
)
def test_what_is_no_item_is_refused_and_nothing_is_written(
    key: int | slice, given: Any, kind: type[Exception], words: str
) -> None:
    held = Held("uint8", (8, 3))
    with pytest.raises(kind, match=words):
        held.memory[key] = given
    assert not any(isinstance(request, rq.WriteData) for request in held.asked)


@pytest.mark.parametrize(
    ("dtype", "given", "words"),
    [
        ("int16", [40000, 0], "a value does not fit"),
        ("uint8", np.array([-1, 0, 0, 0], np.int8), "a value does not fit"),
        ("int16", [0.5, 0], "has int16, not float64: convert with astype"),
        ("float32", [1j], "has float32, not complex128: convert with astype"),
        ("float32", [1e300], "a value is beyond its range"),
        ("float16", [70000, 1.0], "a value is beyond its range"),
        ("complex64", [1e300], "a value is beyond its range"),
        ("int16", np.empty(0, np.int16), "there are no bytes to be written"),
    ],
)
def test_values_that_a_memory_cannot_hold_are_refused(dtype: str, given: Any, words: str) -> None:
    held = Held(dtype, (16,))
    with pytest.raises(InvalidRequest, match=f"memory 'table'.*{words}"):
        held.memory.write(given)


@pytest.mark.parametrize(
    ("dtype", "given"),
    [
        ("uint8", np.array([1, 2, 3, 4], np.int64)),
        ("int16", np.array([1, -2], np.int64)),
        ("float32", [1, 2]),
        ("float32", [float("inf"), float("nan")]),
        ("float64", np.array([1, 2], np.uint64)),
        ("complex64", np.array([[1, 2j], [3, 4]])[:, ::-1]),
    ],
)
def test_values_that_it_can_hold_are_converted(dtype: str, given: Any) -> None:
    held = Held(dtype, (16,))
    expected = np.asarray(given).reshape(-1)
    assert held.memory.write(given, offset=8) == expected.size * held.values.itemsize
    begin = 8 // held.values.itemsize
    assert np.array_equal(held.values[begin : begin + expected.size], expected, equal_nan=True)


def test_a_memory_longer_than_a_message_is_moved_in_several() -> None:
    held = Held("uint32", ((9 << 20) // 4,), described=False)
    assert np.array_equal(held.memory.read(), held.values)
    values = held.values[::-1].copy()
    assert held.memory.write(values) == 9 << 20
    assert np.array_equal(held.values, values)
    assert np.array_equal(held.memory.read(8), values[2:])
    bytes_ = values.view(np.uint8)
    ragged = held.memory.read(WHOLE - 4, WHOLE + 4)
    assert np.array_equal(ragged, bytes_[WHOLE - 4 : 2 * WHOLE].view("uint32"))
    with pytest.raises(InvalidRequest, match=r"8388612 bytes at offset 1048576; it has 9437184"):
        held.memory.read(1 << 20, (8 << 20) + 4)
    pairs = Held("uint64", (6 << 17, 2))
    assert np.array_equal(pairs.memory.read(), pairs.values)
    half = pairs.memory.read(4, WHOLE + 8)
    assert np.array_equal(half, pairs.values.reshape(-1).view(np.uint8)[4 : WHOLE + 12])


@pytest.mark.parametrize(
    ("offset", "length", "words"),
    [
        (64, None, "offset 64 is not in it; it has 64 bytes"),
        (68, None, "offset 68 is not in it; it has 64 bytes"),
        (4, 0, "0 bytes from offset 4 on are none"),
        (0, -4, "-4 bytes from offset 0 on are none"),
    ],
)
def test_no_bytes_cannot_be_read(offset: int, length: int | None, words: str) -> None:
    with pytest.raises(InvalidRequest, match=f"memory 'table': {words}"):
        Held("uint32", (16,)).memory.read(offset, length)


def test_an_answer_that_is_no_array_is_refused() -> None:
    held = Held("uint32", (16,))
    held.info = replace(held.info, dtype="float128x")
    with pytest.raises(InvalidRequest, match=r"memory 'table': the answer is not a valid \(16,\) float128x: "):
        held.memory.read(0, 64)


def test_the_rest_is_read_if_no_length_is_given() -> None:
    held = Held("uint32", (16,))
    assert np.array_equal(held.memory.read(60).view("uint32"), held.values[15:])
