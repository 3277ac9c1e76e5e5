# SPDX-License-Identifier: Apache-2.0
"""Frames as pictures for terminals: half blocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from cm.cli.view_terminal import drawn, half_blocks


def test_half_blocks_have_two_pixels_each_and_an_odd_row_has_nothing_under_it() -> None:
    above, below = half_blocks(np.array([[[1, 2, 3]], [[4, 5, 6]], [[9, 9, 9]]], np.uint8))
    assert above == "\x1b[38;2;1;2;3;48;2;4;5;6m▀\x1b[0m"
    assert below == "\x1b[38;2;9;9;9;48;2;0;0;0m▀\x1b[0m"


FRAMES = st.sampled_from(["u1", "i2", "f4", "f8", "c8", "?"]).flatmap(
    lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=9))
)


@given(FRAMES, st.integers(1, 40), st.integers(1, 20))
def test_every_frame_can_be_drawn_within_the_terminal(frame: Any, columns: int, rows: int) -> None:
    text, _ = drawn(frame, columns, rows)
    assert 1 <= text.count("\n") <= rows
    assert all(line.count("▀") <= columns for line in text.splitlines())
