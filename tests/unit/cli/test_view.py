# SPDX-License-Identifier: Apache-2.0
"""Frames as pictures for terminals: half blocks; the rest is textual-image's."""

from __future__ import annotations

import re
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from cm.cli.view_terminal import WAYS, Drawer, half_blocks
from cm.errors import InvalidRequest

SHADES = np.add.outer(np.arange(60), np.arange(96)).astype(np.uint8)
COLOURS = np.stack([SHADES, SHADES[::-1], SHADES[:, ::-1]], 2) * np.uint8(2)


def test_half_blocks_have_two_pixels_each_and_an_odd_row_has_nothing_under_it() -> None:
    above, below = half_blocks(np.array([[[1, 2, 3]], [[4, 5, 6]], [[9, 9, 9]]], np.uint8))
    assert above == "\x1b[38;2;1;2;3;48;2;4;5;6m▀\x1b[0m"
    assert below == "\x1b[38;2;9;9;9;48;2;0;0;0m▀\x1b[0m"


FRAMES = st.sampled_from(["u1", "i2", "f4", "f8", "c8", "?"]).flatmap(
    lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=9))
)


@given(FRAMES, st.sampled_from(WAYS), st.integers(1, 40), st.integers(1, 20))
def test_every_frame_can_be_drawn_within_the_terminal(frame: Any, way: str, columns: int, rows: int) -> None:
    drawer = Drawer(way)
    text, _ = drawer.text(frame, columns, rows)
    assert 1 <= text.count("\n") <= rows
    if way == "blocks":
        assert all(line.count("▀") <= columns for line in text.splitlines())
    drawer.close()


@pytest.mark.parametrize("way", ["kitty", "sixel"])
def test_without_the_library_the_extra_that_brings_it_is_named(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "textual_image", None)
    monkeypatch.delitem(sys.modules, "textual_image.renderable", raising=False)
    with pytest.raises(InvalidRequest, match=re.escape("pip install 'textual-image>=0.8'")):
        Drawer(way)
    assert "▀" in Drawer("auto").text(SHADES, 10, 5)[0]
