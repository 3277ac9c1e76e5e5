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

from cm.client.rendering import Bytes, Outline, outline, visible

SIDE = 1280  # pixels at most; of a larger frame every second, third, … pixel is shown
COLUMNS = 1024  # of a signal; a longer one is shown as the least and the greatest value in each
_QUALITY = 85
Array = npt.NDArray[Any]


def raw(stream: str, frame: Array, about: Mapping[str, Any]) -> bytes:
    """For a browser on this machine: what the picture holds, as it is. `about`: what else the header says."""
    return _message(stream, frame, about, _plain)


def small(stream: str, frame: Array, about: Mapping[str, Any]) -> bytes:
    """For a browser on another machine: a JPEG, if it is a picture."""
    return _message(stream, frame, about, _jpeg)


def _message(
    stream: str, frame: Array, about: Mapping[str, Any], packed: Callable[[Bytes], tuple[str, bytes]]
) -> bytes:
    values = np.asarray(frame)
    header: dict[str, Any] = {"stream": stream, "shape": values.shape, "dtype": str(values.dtype), **about}
    if values.size == 0:
        header["kind"], payload = "empty", b""
    elif values.ndim < 2:
        header["kind"], payload = "signal", _signal(outline(np.atleast_1d(values), COLUMNS), header)
    else:
        seen = visible(values, SIDE)
        header["height"], header["width"] = seen.pixels.shape[:2]
        header |= {"step": seen.step} if seen.step > 1 else {}
        header |= {"range": seen.span} if seen.span else {}
        header["kind"], payload = packed(seen.pixels)
    text = json.dumps(header).encode()
    return struct.pack("<H", len(text)) + text + payload


def _signal(signal: Outline, header: dict[str, Any]) -> bytes:
    """The least value of each column, then the greatest, as float32."""
    header.update(columns=len(signal.low), range=signal.span)
    return np.concatenate([signal.low, signal.high]).astype("<f4").tobytes()


def _plain(pixels: Bytes) -> tuple[str, bytes]:
    return ("grey" if pixels.ndim == 2 else "rgb"), pixels.tobytes()


def _jpeg(pixels: Bytes) -> tuple[str, bytes]:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(out, "JPEG", quality=_QUALITY)
    return "jpeg", out.getvalue()
