# SPDX-License-Identifier: Apache-2.0
"""Frames as a browser draws them: grey or RGB bytes, a JPEG, or the outline of a signal.

A message is the length of its header (u16, little-endian), the header as JSON, and the picture's bytes.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

SIDE = 1280  # pixels at most; of a larger frame every second, third, … pixel is shown
COLUMNS = 1024  # of a signal; of a longer one the least and the greatest value in each
_QUALITY = 85
Array = npt.NDArray[Any]


def raw(stream: str, frame: Array, about: Mapping[str, Any]) -> bytes:
    """For a browser on this machine: what the picture holds, as it is. `about`: what else the header says."""
    return _message(stream, frame, about, _plain)


def small(stream: str, frame: Array, about: Mapping[str, Any]) -> bytes:
    """For a browser elsewhere: a JPEG, where it is a picture."""
    return _message(stream, frame, about, _jpeg)


def _message(
    stream: str, frame: Array, about: Mapping[str, Any], packed: Callable[[Array], tuple[str, bytes]]
) -> bytes:
    values = np.asarray(frame)
    header: dict[str, Any] = {"stream": stream, "shape": values.shape, "dtype": str(values.dtype), **about}
    if values.size == 0:
        header["kind"], payload = "empty", b""
    elif values.ndim < 2:
        payload = _outline(np.atleast_1d(values), header)
    else:
        pixels = _visible(values, header)
        header["height"], header["width"] = pixels.shape[:2]
        header["kind"], payload = packed(pixels)
    text = json.dumps(header).encode()
    return struct.pack("<H", len(text)) + text + payload


def _visible(values: Array, header: dict[str, Any]) -> npt.NDArray[np.uint8]:
    """Rows × columns, or rows × columns × 3, of bytes."""
    while values.ndim > 3 or (values.ndim == 3 and values.shape[2] not in (1, 3, 4)):
        values = values[0]  # the first of several planes
    if values.ndim == 3:
        values = values[:, :, 0] if values.shape[2] == 1 else values[:, :, :3]
    step = max(1, -(-max(values.shape[:2]) // SIDE))
    if step > 1:
        values = values[::step, ::step]
        header["step"] = step
    return _bytes(values, header)


def _bytes(values: Array, header: dict[str, Any]) -> npt.NDArray[np.uint8]:
    if values.dtype == np.uint8:
        return values
    numbers = _real(values)
    low, high = _span(numbers)
    header["range"] = [low, high]
    scaled = (numbers - low) * (255.0 / (high - low) if high > low else 0.0)
    return np.nan_to_num(scaled, nan=0.0, posinf=255.0, neginf=0.0).clip(0, 255).astype(np.uint8)


def _real(values: Array) -> npt.NDArray[np.float64]:
    return np.abs(values) if np.iscomplexobj(values) else values.astype(np.float64)


def _span(numbers: npt.NDArray[np.float64]) -> tuple[float, float]:
    """The least and the greatest that is finite."""
    finite = numbers[np.isfinite(numbers)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def _outline(values: Array, header: dict[str, Any]) -> bytes:
    """The least value of each column, then the greatest, as float32."""
    numbers = np.nan_to_num(_real(values), posinf=0.0, neginf=0.0)
    edges = np.linspace(0, len(numbers), min(len(numbers), COLUMNS) + 1).astype(np.int64)[:-1]
    low, high = np.minimum.reduceat(numbers, edges), np.maximum.reduceat(numbers, edges)
    header.update(kind="signal", columns=len(edges), range=_span(numbers))
    return np.concatenate([low, high]).astype("<f4").tobytes()


def _plain(pixels: npt.NDArray[np.uint8]) -> tuple[str, bytes]:
    return ("grey" if pixels.ndim == 2 else "rgb"), pixels.tobytes()


def _jpeg(pixels: npt.NDArray[np.uint8]) -> tuple[str, bytes]:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(out, "JPEG", quality=_QUALITY)
    return "jpeg", out.getvalue()
