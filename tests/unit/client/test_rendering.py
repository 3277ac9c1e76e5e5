# SPDX-License-Identifier: Apache-2.0
"""Arrays as pixels: what can be seen of a frame, and what lies in memory of its colours."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from PIL import Image

from cm.client.pixel_formats import from_rgb, is_rgb, to_rgb
from cm.client.rendering import coloured, fitted, outline, picture, plotted, resized, visible

SHADES = np.add.outer(np.arange(60), np.arange(96)).astype(np.uint8)
COLOURS = np.stack([SHADES, SHADES[::-1], SHADES[:, ::-1]], 2) * np.uint8(2)
RGB = np.array([[(1, 2, 3), (4, 5, 6)]], np.uint8)


@pytest.mark.parametrize("picture", [SHADES, COLOURS], ids=["grey", "colours"])
@pytest.mark.parametrize("factor", [1, 2, 3, 12])
def test_a_smaller_picture_is_the_mean_of_what_falls_together(picture: Any, factor: int) -> None:
    made = resized(picture, 96 // factor, 60 // factor)
    expected = np.asarray(Image.fromarray(picture).resize((96 // factor, 60 // factor), Image.Resampling.BOX))
    assert np.abs(made.astype(int) - expected).max() <= 2  # ours is rounded down, once along each axis


@pytest.mark.parametrize(
    ("pixels", "size", "seen"),
    [
        (np.arange(16).reshape(4, 4), (2, 2), [[2, 4], [10, 12]]),
        (np.arange(5).reshape(1, 5) * 10, (2, 1), [[5, 30]]),
        (np.arange(3).reshape(1, 3) * 10, (6, 2), [[0, 0, 10, 10, 20, 20]] * 2),
        (np.arange(6).reshape(2, 1, 3), (1, 1), [[[1, 2, 3]]]),
    ],
)
def test_pixels_that_fall_together_are_averaged_and_others_repeated(
    pixels: Any, size: tuple[int, int], seen: list[Any]
) -> None:
    assert resized(pixels.astype(np.uint8), *size).tolist() == seen


def test_a_picture_keeps_its_proportions() -> None:
    assert fitted(SHADES, 48, 1000).shape == (30, 48)
    assert fitted(SHADES, 1000, 30).shape == (30, 48)
    assert fitted(SHADES, 192, 120).shape == (120, 192)
    assert fitted(SHADES[:1], 10, 10).shape == (1, 10)
    assert fitted(SHADES[:, :1], 10, 10).shape == (10, 1)
    assert coloured(SHADES[:1, :2]).tolist() == [[[0, 0, 0], [1, 1, 1]]]
    assert coloured(COLOURS) is COLOURS


W, B = 255, 0


@pytest.mark.parametrize(
    ("values", "width", "height", "seen"),
    [
        ([0, 1, 2, 3], 4, 4, [[B, B, B, W], [B, B, W, W], [B, W, W, B], [W, W, B, B]]),
        ([0, 3, 0, 3], 4, 4, [[B, W, W, W], [B, W, W, B], [B, W, W, B], [W, W, W, B]]),
        ([1, 1], 4, 3, [[B] * 4, [B] * 4, [W] * 4]),
        (range(8), 2, 4, [[B, W], [W, W], [W, W], [W, B]]),
        ([0, 6], 4, 2, [[B, B, W, W], [W, W, W, B]]),
    ],
)
def test_a_signal_is_drawn_without_gaps(values: Any, width: int, height: int, seen: list[list[int]]) -> None:
    assert plotted(outline(np.array(values), width), width, height).tolist() == seen


def test_a_signal_has_the_least_and_the_greatest_of_what_falls_into_a_column() -> None:
    found = outline(np.arange(10).reshape(2, 5), 4)
    assert (found.low.tolist(), found.high.tolist()) == ([0, 2, 5, 7], [1, 4, 6, 9])
    assert found.span == (0.0, 9.0)
    strange = outline(np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 3 + 4j]), 9)
    assert strange.low.tolist() == strange.high.tolist() == [0, 0, 0, 1e38, 1e38, 5]
    assert outline(np.array([-np.inf, np.inf, -1e300]), 3).low.tolist() == [0, 0, -1e38]


@pytest.mark.parametrize(
    ("shape", "side", "pixels", "step"),
    [
        ((50, 4000), 1280, (13, 1000), 4),
        ((4000, 50), 1280, (1000, 13), 4),
        ((4, 4), 4, (4, 4), 1),
        ((5, 4), 4, (3, 2), 2),
        ((4, 4, 1), 4, (4, 4), 1),
        ((4, 4, 3), 4, (4, 4, 3), 1),
        ((4, 4, 4), 4, (4, 4, 3), 1),  # without what is transparent
        ((7, 4, 5), 5, (4, 5), 1),  # the first of seven planes
        ((2, 4, 5, 3), 5, (4, 5, 3), 1),
        ((1, 2, 4, 5), 5, (4, 5), 1),
    ],
)
def test_what_is_seen_of_a_frame_is_its_first_plane_subsampled(
    shape: tuple[int, ...], side: int, pixels: tuple[int, ...], step: int
) -> None:
    values = np.arange(np.prod(shape)).reshape(shape).astype(np.uint8)
    found = visible(values, side)
    assert (found.pixels.shape, found.step, found.span) == (pixels, step, None)
    assert found.pixels.flat[0] == 0


@pytest.mark.parametrize(
    ("values", "size", "seen", "span"),
    [
        (np.zeros((0, 3)), (4, 4), [[B]], "nothing in it"),
        (np.array(3.0), (4, 4), [[B] * 4, [B] * 4, [W] * 4], "3 to 3"),
        (np.array([1, 2.5]), (2, 9), [[B, W], [W, W]], "1 to 2.5"),
        (np.array([[0, 5], [10, 20]]), (2, 2), [[0, 64], [128, 255]], "0 to 20"),
        (np.array([[0, 5], [10, 20]], np.uint8), (2, 2), [[0, 5], [10, 20]], ""),
        (np.array([[0, np.inf], [-np.inf, np.nan]]), (2, 2), [[0, 0], [0, 0]], "0 to 0"),
        (np.array([[-1, np.inf], [-np.inf, 1]]), (2, 2), [[0, 255], [0, 255]], "-1 to 1"),
        (np.array([[3 + 4j, 0]]), (2, 1), [[255, 0]], "0 to 5"),
    ],
)
def test_any_frame_has_a_picture_and_the_span_of_its_numbers(
    values: Any, size: tuple[int, int], seen: list[list[int]], span: str
) -> None:
    found, told = picture(values, *size)
    assert (found.tolist(), told) == (seen, span)


def test_a_large_frame_is_subsampled_to_four_times_what_is_shown() -> None:
    values = np.tile(np.array([0, 80], np.uint8), (8, 8))
    assert picture(values, 4, 2)[0].tolist() == [[40] * 4] * 2
    assert picture(np.tile(values, (2, 2)), 4, 2)[0].tolist() == [[0] * 4] * 2


@pytest.mark.parametrize(("form", "memory"), [("bgr", [3, 2, 1, 6, 5, 4]), ("rbg", [2, 3, 1, 5, 6, 4])])
def test_the_lowest_bits_of_a_pixel_come_first(form: str, memory: list[int]) -> None:
    """Of Xilinx' order the UG934 says: red in bits 23 to 16, blue in 15 to 8, green in 7 to 0."""
    assert from_rgb(RGB, form).reshape(-1).tolist() == memory
    assert np.array_equal(to_rgb(from_rgb(RGB, form), form), RGB)


@pytest.mark.parametrize(
    ("rgb", "yuv"),
    [
        ((0, 0, 0), (16, 128, 128)),
        ((255, 255, 255), (235, 128, 128)),
        ((255, 0, 0), (82, 90, 240)),
        ((0, 0, 255), (41, 240, 110)),
    ],
)
def test_yuv_has_the_values_of_bt_601(rgb: tuple[int, ...], yuv: tuple[int, int, int]) -> None:
    picture = np.full((1, 2, 3), rgb, np.uint8)
    y, cb, cr = yuv
    assert from_rgb(picture, "yuv422").tolist() == [[[y, cb], [y, cr]]]
    assert np.abs(to_rgb(from_rgb(picture, "yuv422"), "yuv422").astype(int) - picture).max() <= 2


def test_two_pixels_of_yuv_share_their_mean_colour_and_values_stay_within_bytes() -> None:
    assert from_rgb(np.array([[(10, 20, 30), (40, 51, 60)]], np.uint8), "yuv422").tolist() == [[[32, 134], [58, 123]]]
    assert from_rgb(np.array([[(0, 255, 0), (0, 0, 255)]], np.uint8), "yuv422").tolist() == [[[144, 147], [41, 72]]]
    seen = to_rgb(np.array([[(235, 255), (16, 255), (100, 0), (100, 0)]], np.uint8), "yuv422").tolist()
    assert seen == [[[255, 102, 255], [203, 0, 255], [0, 252, 0], [0, 252, 0]]]


@pytest.mark.parametrize(("data", "is_one"), [(RGB, True), (RGB[0], False), (RGB[:, :, :2], False), (b"abc", False)])
def test_a_picture_in_rgb_is_an_array_of_bytes_with_rows_columns_and_three_channels(data: Any, is_one: bool) -> None:
    assert is_rgb(data) is is_one
    assert not is_one or not is_rgb(data.astype(np.uint16))
