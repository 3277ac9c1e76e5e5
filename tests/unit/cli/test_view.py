# SPDX-License-Identifier: Apache-2.0
"""Frames as pictures for terminals: what is shown of an array, and escape sequences, read by independent decoders."""

from __future__ import annotations

import base64
import io
import re
import shutil
import subprocess
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from cm.cli.drawing import half_blocks, kitty, sixel
from cm.cli.drawing.drawing import WAYS, drawing
from cm.cli.drawing.pixels import fitted, outline, plotted, resized, visible
from cm.cli.drawing.terminal import Ability, Size, has_true_colour, understood

SHADES = np.add.outer(np.arange(60), np.arange(96)).astype(np.uint8)
COLOURS = np.stack([SHADES, SHADES[::-1], SHADES[:, ::-1]], 2) * np.uint8(2)
needs_sixel2png = pytest.mark.skipif(not shutil.which("sixel2png"), reason="needs sixel2png: apt install libsixel-bin")


# ---- what is seen -----------------------------------------------------------------------


@pytest.mark.parametrize("picture", [SHADES, COLOURS], ids=["grey", "colours"])
@pytest.mark.parametrize("factor", [1, 2, 3, 12])
def test_a_smaller_picture_is_the_mean_of_what_falls_together(picture: Any, factor: int) -> None:
    made = resized(picture, 96 // factor, 60 // factor)
    expected = np.asarray(Image.fromarray(picture).resize((96 // factor, 60 // factor), Image.Resampling.BOX))
    assert np.abs(made.astype(int) - expected).max() <= 2  # ours is rounded down, once along each axis


def test_a_picture_keeps_its_proportions() -> None:
    assert fitted(SHADES, 48, 1000).shape == (30, 48)
    assert fitted(SHADES, 1000, 30).shape == (30, 48)
    assert fitted(SHADES, 192, 120).shape == (120, 192)


def test_a_signal_is_drawn_without_gaps() -> None:
    wave = np.sign(np.sin(np.linspace(0, 20, 5000)))
    picture = plotted(outline(wave, 80), 80, 40)
    assert (picture.max(0) == 255).all()
    edges = np.flatnonzero((picture == 255).sum(0) > 30)  # where it goes from one end to the other
    assert len(edges) >= 6


# ---- sixels -----------------------------------------------------------------------------


def decoded(text: str) -> Any:
    """Decode by libsixel."""
    done = subprocess.run(["sixel2png", "-i", "-", "-o", "-"], input=text.encode(), capture_output=True, check=True)
    with Image.open(io.BytesIO(done.stdout)) as image:
        return np.asarray(image.convert("RGB"))


@needs_sixel2png
@pytest.mark.parametrize("height", [1, 5, 6, 7, 60])
def test_grey_sixels_match_the_picture_except_for_the_lowest_bits(height: int) -> None:
    shown = decoded(sixel.encoded(SHADES[:height]))
    assert shown.shape == (height, 96, 3)
    assert np.abs(shown[..., 1].astype(int) - SHADES[:height]).max() <= 6


@needs_sixel2png
def test_coloured_sixels_match_the_picture_on_average() -> None:
    shown = decoded(sixel.encoded(COLOURS))
    means = [np.asarray(Image.fromarray(p).resize((8, 5), Image.Resampling.BOX)).astype(int) for p in (shown, COLOURS)]
    assert np.abs(means[0] - means[1]).max() <= 26  # half a step of the cube's six: the rest is dithered


# ---- kitty ------------------------------------------------------------------------------


def received(text: str) -> tuple[dict[str, str], Any]:
    """The keys of the first sequence, and the picture, decoded by the protocol's description."""
    found = re.findall(r"\x1b_G([^;]*);([^\x1b]*)\x1b\\", text)
    assert "".join(f"\x1b_G{keys};{data}\x1b\\" for keys, data in found) == text
    assert all(len(data) <= 4096 and len(data) % 4 == 0 for _, data in found)
    keys = dict(pair.split("=") for pair in found[0][0].split(","))
    assert [k[0].split("m=")[1] for k in found] == ["1"] * (len(found) - 1) + ["0"]
    data = zlib.decompress(base64.b64decode("".join(data for _, data in found)))
    return keys, np.frombuffer(data, np.uint8).reshape(int(keys["v"]), int(keys["s"]), 3)


def test_a_picture_by_kittys_protocol_comes_whole_however_long_it_is() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (200, 300, 3), np.uint8)
    keys, picture = received(kitty.encoded(noise, 40, 12))
    assert np.array_equal(picture, noise)
    assert (keys["a"], keys["f"], keys["c"], keys["r"], keys["q"]) == ("T", "24", "40", "12", "2")


# ---- half blocks ------------------------------------------------------------------------


def test_colours_of_256_are_near_those_of_24_bits() -> None:
    (line,) = half_blocks.lines(
        np.array([[[255, 0, 0], [128, 128, 128]], [[0, 0, 0], [95, 135, 255]]], np.uint8), False
    )
    assert re.findall(r"38;5;(\d+);48;5;(\d+)", line) == [("196", "16"), ("244", "69")]


def test_an_odd_row_has_nothing_under_it() -> None:
    assert half_blocks.lines(np.full((3, 1), 9, np.uint8), True)[1].startswith("\x1b[38;2;9;9;9;48;2;0;0;0m▀")


# ---- the terminal -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("answer", "ability"),
    [
        (b"\x1b[?63;1;2;4;6;9;15;16;22;28c", Ability("sixel")),  # xterm -ti vt340
        (b"\x1b[6;17;8t\x1b[?62;4;22c", Ability("sixel", (8, 17))),  # foot
        (b"\x1b_Gi=31;OK\x1b\\\x1b[6;38;17t\x1b[?62;c", Ability("kitty", (17, 38))),
        (b"\x1b_Gi=31;ENODATA:no\x1b\\\x1b[?62;4c", Ability("sixel")),
        (b"\x1b[?1;2c", Ability("blocks")),  # tmux 3.3
        (b"\x1b[?64;1;2;6;9;15;18;21;22c", Ability("blocks")),  # xterm: 64 and 14 are not 4
        (b"\x1b[?4c", Ability("blocks")),  # a VT132, by its first number
        (b"", Ability("blocks")),
    ],
)
def test_a_terminal_is_recognised_by_its_answer(answer: bytes, ability: Ability) -> None:
    assert understood(answer) == ability


@given(st.binary(max_size=60))
def test_any_answer_of_a_terminal_is_accepted(answer: bytes) -> None:
    assert understood(answer).way in WAYS


def test_true_colour_is_announced_by_the_environment() -> None:
    assert has_true_colour({"COLORTERM": "truecolor"})
    assert has_true_colour({"TERM": "xterm-direct"})
    assert not has_true_colour({"TERM": "xterm-256color"})


# ---- everything ---------------------------------------------------------------------------


FRAMES = st.sampled_from(["u1", "i2", "f4", "f8", "c8", "?"]).flatmap(
    lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=9))
)


@given(FRAMES, st.sampled_from(WAYS), st.integers(1, 40), st.integers(1, 20))
def test_every_frame_can_be_drawn_within_the_terminal(frame: Any, way: str, columns: int, rows: int) -> None:
    made = drawing(frame, way, Size(columns, rows), True)
    assert 1 <= made.rows <= max(1, rows - 1)
    if way == "blocks":
        assert all(line.count("▀") <= columns for line in made.text.split("\r\n"))


def test_a_picture_that_is_too_large_is_subsampled() -> None:
    assert visible(np.zeros((50, 4000), np.uint8), 1280).pixels.shape == (13, 1000)
