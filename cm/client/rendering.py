# SPDX-License-Identifier: Apache-2.0
"""Arrays as pixels: what can be seen of a frame, whatever its shape and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from cm.frozen import dataclass

Array = npt.NDArray[Any]
MOST = 1e38  # greatest value of a signal: close to what a float32 can hold
Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Visible:
    """Rows × columns, or rows × columns × 3, of bytes.

    `step`: only every step-th pixel is shown. `span`: the numbers that are black and white, where they were spread.
    """

    pixels: Bytes
    step: int = 1
    span: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Outline:
    """A signal: the least and the greatest value of each column."""

    low: npt.NDArray[np.float64]
    high: npt.NDArray[np.float64]

    @property
    def span(self) -> tuple[float, float]:
        """The least and the greatest value of the whole signal."""
        return float(self.low.min()), float(self.high.max())


def picture(frame: Array, width: int, height: int) -> tuple[Bytes, str]:
    """Any frame within that many pixels, a signal as its curve; and the span of its numbers, where they were spread."""
    values = np.asarray(frame)
    if values.size == 0:
        return np.zeros((1, 1), np.uint8), "nothing in it"
    if values.ndim < 2:
        signal = outline(np.atleast_1d(values), width)
        return plotted(signal, width, min(height, width // 2 + 1)), "{:g} to {:g}".format(*signal.span)
    seen = visible(values, 4 * max(width, height))
    return fitted(seen.pixels, width, height), "{:g} to {:g}".format(*seen.span) if seen.span else ""


def visible(values: Array, side: int) -> Visible:
    """A frame of two axes or more as a picture of at most `side` pixels in each direction."""
    while values.ndim > 3 or (values.ndim == 3 and values.shape[2] not in (1, 3, 4)):
        values = values[0]  # the first of several planes
    if values.ndim == 3:
        values = values[:, :, 0] if values.shape[2] == 1 else values[:, :, :3]
    step = max(1, -(-max(values.shape[:2]) // side))
    return _bytes(values[::step, ::step], step)


def _bytes(values: Array, step: int) -> Visible:
    if values.dtype == np.uint8:
        return Visible(values, step)
    pixels, span = scaled(values)
    return Visible(pixels, step, span)


def scaled(values: Array) -> tuple[Bytes, tuple[float, float]]:
    """Numbers as bytes, from the smallest finite one to the largest; and these two."""
    numbers = _real(values)
    finite = numbers[np.isfinite(numbers)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    with np.errstate(all="ignore"):  # of values that are infinite, nearly so, or not numbers
        shares = (numbers - low) / (high - low) * 255.0 if high > low else np.zeros_like(numbers)
    return np.rint(np.nan_to_num(shares, nan=0.0, posinf=255.0, neginf=0.0).clip(0, 255)).astype(np.uint8), (low, high)


def outline(values: Array, columns: int) -> Outline:
    """A signal in at most that many columns."""
    numbers = np.clip(np.nan_to_num(_real(values.ravel()), posinf=0.0, neginf=0.0), -MOST, MOST)
    edges = np.linspace(0, len(numbers), min(len(numbers), columns) + 1).astype(np.int64)[:-1]
    return Outline(np.minimum.reduceat(numbers, edges), np.maximum.reduceat(numbers, edges))


def plotted(signal: Outline, width: int, height: int) -> Bytes:
    """A signal as a picture, white on black."""
    low, high = signal.span
    scale = (height - 1) / (high - low) if high > low else 0.0
    places = np.minimum(np.arange(width) * len(signal.low) // width, len(signal.low) - 1)
    bottom = height - 1 - (signal.low[places] - low) * scale
    top = height - 1 - (signal.high[places] - low) * scale
    top[1:] = np.minimum(top[1:], bottom[:-1])  # from column to column without gaps
    bottom[1:] = np.maximum(bottom[1:], top[:-1])
    rows = np.arange(height)[:, np.newaxis]
    drawn = (rows >= np.floor(top)) & (rows <= np.ceil(bottom))
    return np.where(drawn, np.uint8(255), np.uint8(0))


def fitted(pixels: Bytes, width: int, height: int) -> Bytes:
    """A picture within that many pixels, with its proportions kept; pixels that fall together are averaged."""
    rows, columns = pixels.shape[:2]
    factor = min(width / columns, height / rows)
    wide, tall = max(1, round(columns * factor)), max(1, round(rows * factor))
    return resized(pixels, min(wide, width), min(tall, height))


def resized(pixels: Bytes, width: int, height: int) -> Bytes:
    """A picture of exactly that many pixels."""
    return _along(_along(pixels, height, 0), width, 1)


def _along(pixels: Bytes, length: int, axis: int) -> Bytes:
    there = pixels.shape[axis]
    if length >= there:
        return pixels if length == there else pixels.take(np.arange(length) * there // length, axis)
    edges = np.arange(length) * there // length
    sums = np.add.reduceat(pixels, edges, axis, dtype=np.uint32)
    counts = np.diff(np.append(edges, there))
    shape = [1] * pixels.ndim
    shape[axis] = length
    return np.asarray(sums // counts.reshape(shape), np.uint8)


def coloured(pixels: Bytes) -> Bytes:
    """Rows × columns × 3, for grey pictures too."""
    return pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, np.newaxis], 3, 2)


def _real(values: Array) -> npt.NDArray[np.float64]:
    with np.errstate(all="ignore"):
        return np.abs(values).astype(np.float64) if np.iscomplexobj(values) else values.astype(np.float64)
