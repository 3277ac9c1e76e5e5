# SPDX-License-Identifier: Apache-2.0
"""Arrays as PNG pictures, written here so that showing a frame needs no other package."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.client.rendering import scaled
from cm.errors import InvalidRequest

Array = npt.NDArray[Any]
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}  # channels → PNG's: grey, grey + alpha, RGB, RGBA (ISO/IEC 15948, 11.2.2)


class Picture:
    """An array that a notebook shows as a picture: (rows, columns), or (rows, columns, 1 to 4 channels).

    uint8 is shown as it is, bool as black and white, complex numbers by their magnitude; all others from their
    smallest value (black) to their largest (white).
    """

    def __init__(self, array: npt.ArrayLike) -> None:
        """Raises InvalidRequest for what has no rows and columns."""
        self.array: Array = np.asarray(array)
        if not has_rows(self.array):
            raise InvalidRequest(
                f"no picture: an array of {self.array.shape} has no rows and columns of 1 to 4 channels"
            )

    def _repr_png_(self) -> bytes:
        return png(self.array)

    def __repr__(self) -> str:
        return f"<picture of {self.array.shape} {self.array.dtype}>"


def has_rows(array: Array) -> bool:
    """Whether an array can be a picture."""
    return array.size > 0 and (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in _COLOUR_TYPES))


def png(array: Array) -> bytes:
    """A PNG file of an array that `has_rows`, as `Picture` shows it."""
    pixels = _bytes_of(array)
    rows, columns = pixels.shape[:2]
    head = struct.pack(">IIBBBBB", columns, rows, 8, _COLOUR_TYPES[pixels.shape[2]], 0, 0, 0)
    lines = np.zeros((rows, 1 + columns * pixels.shape[2]), np.uint8)  # each begins with its filter: 0, none
    lines[:, 1:] = pixels.reshape(rows, -1)
    data = zlib.compress(lines.tobytes())
    return b"".join((_SIGNATURE, _chunk(b"IHDR", head), _chunk(b"IDAT", data), _chunk(b"IEND", b"")))


def _bytes_of(array: Array) -> npt.NDArray[np.uint8]:
    """(rows, columns, channels) of uint8."""
    pixels = array if array.ndim == 3 else array[:, :, np.newaxis]
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype == np.bool_:
        return pixels.astype(np.uint8) * np.uint8(255)
    return scaled(pixels)[0]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
