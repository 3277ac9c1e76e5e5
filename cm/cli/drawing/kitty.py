# SPDX-License-Identifier: Apache-2.0
"""Pictures by kitty's "Terminal graphics protocol", as its documentation has it; WezTerm and others know it too."""

from __future__ import annotations

import binascii
import zlib

import numpy as np

from cm.cli.drawing.pixels import Bytes, coloured

IMAGE = 4211  # its number in the terminal: each frame replaces the one before
_PIECE = 4096  # characters of one sequence at most
DELETE = f"\x1b_Ga=d,d=I,i={IMAGE},q=2\x1b\\"
QUERY = "\x1b_Gi=31,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\"  # a terminal that knows the protocol answers i=31;OK


def encoded(pixels: Bytes, columns: int, rows: int) -> str:
    """A picture that the terminal scales to that many cells; the cursor stays where it is."""
    picture = np.ascontiguousarray(coloured(pixels))
    height, width = picture.shape[:2]
    data = binascii.b2a_base64(zlib.compress(picture.tobytes(), 1), newline=False).decode("ascii")
    pieces = [data[at : at + _PIECE] for at in range(0, len(data), _PIECE)]
    head = f"a=T,f=24,o=z,s={width},v={height},c={columns},r={rows},i={IMAGE},p=1,C=1,q=2,"
    last = len(pieces) - 1
    return "".join(
        f"\x1b_G{head if at == 0 else ''}m={int(at < last)};{piece}\x1b\\" for at, piece in enumerate(pieces)
    )
