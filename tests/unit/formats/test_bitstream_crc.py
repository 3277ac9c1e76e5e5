# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import struct

from bitstream_support import slow_crc
from hypothesis import given
from hypothesis import strategies as st

from cm.device.native import bitstream as native

WORDS = st.lists(st.integers(0, 0xFFFFFFFF), max_size=40)


@given(words=WORDS, register=st.integers(0, 31), start=st.integers(0, 0xFFFFFFFF))
def test_crc_equals_one_computed_bit_by_bit(words: list[int], register: int, start: int) -> None:
    data = struct.pack(f">{len(words)}I", *words)
    assert native.crc(start, register, data) == slow_crc(register, words, start)


@given(words=WORDS, register=st.integers(0, 31))
def test_crc_of_swapped_words_is_the_same(words: list[int], register: int) -> None:
    swapped = struct.pack(f"<{len(words)}I", *words)
    assert native.crc(0, register, swapped, swapped=True) == slow_crc(register, words)


@given(words=WORDS, cut=st.integers(0, 40))
def test_crc_continues_where_it_stopped(words: list[int], cut: int) -> None:
    data = struct.pack(f">{len(words)}I", *words)
    first = native.crc(0, 2, data[: 4 * cut])
    assert native.crc(first, 2, data[4 * cut :]) == native.crc(0, 2, data)


def test_crc_of_a_write_that_a_real_device_accepts() -> None:
    # From a partial bitstream of Vivado 2020 for xc7z020: CMD=SHUTDOWN alone, then its CRC.
    assert native.crc(0, 4, struct.pack(">I", 11)) == 0x5DA98E32


@given(data=st.binary(max_size=64).map(lambda raw: raw[: len(raw) // 4 * 4]))
def test_swap_reverses_each_word(data: bytes) -> None:
    words = struct.unpack(f">{len(data) // 4}I", data)
    assert native.swap(data) == struct.pack(f"<{len(words)}I", *words)
