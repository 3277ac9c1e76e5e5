# SPDX-License-Identifier: Apache-2.0
"""What happens in the fleet's demonstration: printed at once, and as a picture, with a lane for each board."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from cm.wire.messages.fleet import BoardStatus

Picture = np.ndarray[Any, np.dtype[np.uint8]]


@dataclass
class Course:
    """What happened: `said` with the second of each, modes of boards by time (empty: gone), and pictures.

    `wanted`: the modes that were wanted of them, likewise.
    """

    begun: float = field(default_factory=time.monotonic)
    said: list[tuple[float, str, str]] = field(default_factory=list)
    modes: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    wanted: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    pictures: list[tuple[str, Picture]] = field(default_factory=list)
    ended: float = 0.0

    @property
    def now(self) -> float:
        """Seconds since it began."""
        return time.monotonic() - self.begun

    def say(self, board: str, text: str) -> None:
        """Note it, and print it at once."""
        self.said.append((self.now, board, text))
        print(f"{self.now:7.3f} s  {board:6}  {text}", flush=True)

    def saw(self, board: str, status: BoardStatus | None) -> None:
        """A status, or that the board has gone."""
        self._into(self.modes, board, status.status.mode or "…" if status else "")

    def wants(self, board: str, mode: str) -> None:
        """What is wanted of a board now."""
        self._into(self.wanted, board, mode)

    def _into(self, lanes: dict[str, list[tuple[float, str]]], board: str, mode: str) -> None:
        lane = lanes.setdefault(board, [])
        if not lane or lane[-1][1] != mode:
            lane.append((self.now, mode))


_WIDTH, _MARGIN, _LANE, _NAME, _LINE = 1200, 16, 58, 70, 18
_WANTED = 16  # of a lane: what is wanted, above what is
_BACKGROUND, _INK, _FAINT = (24, 26, 30), (230, 230, 230), (120, 124, 132)
_COLOURS = {
    "default": (70, 110, 170),
    "edge_detection": (60, 150, 90),
    "colorise": (190, 110, 50),
    "loopback_edge": (140, 90, 170),
    "": (46, 48, 54),
}


def draw(course: Course, path: Path) -> None:
    """Write a PNG."""
    lanes = sorted(course.modes)
    thumb = (_WIDTH - 2 * _MARGIN - 2 * _MARGIN) // 3
    height = thumb * 3 // 4
    top_said = _MARGIN + len(lanes) * _LANE + _LINE
    top_pictures = top_said + len(course.said) * _LINE + _MARGIN
    image = Image.new("RGB", (_WIDTH, top_pictures + _LINE + height + _MARGIN), _BACKGROUND)
    canvas = ImageDraw.Draw(image)
    for row, board in enumerate(lanes):
        _lane(canvas, course, board, _MARGIN + row * _LANE)
    _marks(canvas, course, lanes)
    for row, (second, board, text) in enumerate(course.said):
        canvas.text((_MARGIN, top_said + row * _LINE), f"{row + 1:2}  {second:6.2f} s  {board}: {text}", fill=_INK)
    for column, (label, picture) in enumerate(course.pictures[:3]):
        left = _MARGIN + column * (thumb + _MARGIN)
        canvas.text((left, top_pictures), label, fill=_INK)
        small = Image.fromarray(picture).convert("RGB").resize((thumb, height), Image.Resampling.LANCZOS)
        image.paste(small, (left, top_pictures + _LINE))
    image.save(path)


def _place(course: Course, second: float) -> int:
    span = _WIDTH - _NAME - 2 * _MARGIN
    return _MARGIN + _NAME + int(span * min(1.0, second / max(course.ended, 1e-9)))


def _lane(canvas: ImageDraw.ImageDraw, course: Course, board: str, top: int) -> None:
    canvas.text((_MARGIN, top + _LANE // 3), board, fill=_INK)
    _band(
        canvas, course, course.wanted.get(board, []), (top + 4, top + 4 + _WANTED), "wanted: {}", "nothing wanted yet"
    )
    _band(canvas, course, course.modes[board], (top + 6 + _WANTED, top + _LANE - 8), "{}", "gone")


def _band(
    canvas: ImageDraw.ImageDraw,
    course: Course,
    changes: list[tuple[float, str]],
    rows: tuple[int, int],
    words: str,
    empty: str,
) -> None:
    """One colour for each mode over time; `rows` are the band's first and last."""
    for number, (second, mode) in enumerate(changes):
        until = changes[number + 1][0] if number + 1 < len(changes) else course.ended
        left, right, text = _place(course, second), _place(course, until), words.format(mode) if mode else empty
        canvas.rectangle((left, rows[0], right, rows[1]), fill=_COLOURS.get(mode, _FAINT))
        if right - left > 7 * len(text):
            canvas.text((left + 4, (rows[0] + rows[1]) // 2 - 6), text, fill=_INK)


def _marks(canvas: ImageDraw.ImageDraw, course: Course, lanes: list[str]) -> None:
    """The number of each thing that was said, where it happened."""
    for number, (second, board, _) in enumerate(course.said):
        if board in lanes:
            left, top = _place(course, second), _MARGIN + lanes.index(board) * _LANE
            canvas.line((left, top, left, top + _LANE - 4), fill=_INK)
            canvas.text((left + 2, top - 8), str(number + 1), fill=_INK)
