# SPDX-License-Identifier: Apache-2.0
"""Frames as a browser draws them: grey or RGB bytes, a JPEG, or a signal.

A message is the length of its header (u16, little-endian), the header as JSON, and the picture's bytes.
"""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.client.rendering import Bytes, visible
from cm.web import signals

SIDE = 1280  # pixels at most; of a larger frame every second, third, … pixel is shown
_QUALITY = 85
Array = npt.NDArray[Any]


def message(stream: str, frame: Array, about: Mapping[str, Any], view: str, near: bool) -> bytes:
    """A frame as one page wants it.

    `about`: what else the header says. `view`: of a signal, as `signals.drawn` has it. `near`: the browser is on this
    machine, and gets what a picture holds as it is; another one gets a JPEG.
    """
    values = np.asarray(frame)
    header: dict[str, Any] = {"stream": stream, "shape": values.shape, "dtype": str(values.dtype), **about}
    if values.size == 0:
        header["kind"], payload = "empty", b""
    elif signals.is_signal(values):
        known, planes = signals.drawn(values, view)
        header |= {"kind": "signal", **known}
        payload = np.concatenate(planes).astype("<f4").tobytes()
    else:
        seen = visible(values, SIDE)
        header["height"], header["width"] = seen.pixels.shape[:2]
        header |= {"step": seen.step} if seen.step > 1 else {}
        header |= {"range": seen.span} if seen.span else {}
        header["kind"], payload = (_plain if near else _jpeg)(seen.pixels)
    text = json.dumps(header).encode()
    return struct.pack("<H", len(text)) + text + payload


def _plain(pixels: Bytes) -> tuple[str, bytes]:
    return ("grey" if pixels.ndim == 2 else "rgb"), pixels.tobytes()


def _jpeg(pixels: Bytes) -> tuple[str, bytes]:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(out, "JPEG", quality=_QUALITY)
    return "jpeg", out.getvalue()
