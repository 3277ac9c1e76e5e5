# SPDX-License-Identifier: Apache-2.0
"""Pictures as sixels: DEC STD 070 chapter 9, as the VT340 and xterm have it.

A band is six rows; for each colour in it, one character for each column says which of the six have that colour.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from cm.cli.drawing.pixels import Bytes

_GREYS = 64
_STEPS = 6  # of each colour: 216 together, of the 256 that terminals have
_DITHER = (np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) + 0.5) / 16  # Bayer's


def encoded(pixels: Bytes) -> str:
    """The whole sequence, from DCS to ST."""
    numbers, palette = _grey(pixels) if pixels.ndim == 2 else _coloured(pixels)
    height, width = numbers.shape
    bands = (_band(numbers[row : row + 6]) for row in range(0, height, 6))
    return f'\x1bP0;1q"1;1;{width};{height}{_registers(palette)}{"-".join(bands)}\x1b\\'


def _grey(pixels: Bytes) -> tuple[npt.NDArray[np.intp], list[tuple[int, int, int]]]:
    percents = [round(100 * level / (_GREYS - 1)) for level in range(_GREYS)]
    return np.asarray(pixels // (256 // _GREYS), np.intp), [(p, p, p) for p in percents]


def _coloured(pixels: Bytes) -> tuple[npt.NDArray[np.intp], list[tuple[int, int, int]]]:
    """The nearest colours of the cube, with the error spread over the neighbours."""
    rows, columns = pixels.shape[:2]
    dither = np.tile(_DITHER, (-(-rows // 4), -(-columns // 4)))[:rows, :columns, np.newaxis]
    steps = np.minimum((pixels / 255 * (_STEPS - 1) + dither).astype(np.intp), _STEPS - 1)
    each = [round(100 * step / (_STEPS - 1)) for step in range(_STEPS)]
    return steps @ np.array([_STEPS**2, _STEPS, 1]), [(r, g, b) for r in each for g in each for b in each]


def _registers(palette: list[tuple[int, int, int]]) -> str:
    return "".join(f"#{number};2;{r};{g};{b}" for number, (r, g, b) in enumerate(palette))


def _band(rows: npt.NDArray[np.intp]) -> str:
    weights = (1 << np.arange(len(rows)))[:, np.newaxis]
    parts = []
    for number in np.unique(rows).tolist():
        columns = ((rows == number) * weights).sum(0)
        parts.append(f"#{number}{_runs(columns)}")
    return "$".join(parts)


def _runs(columns: npt.NDArray[np.intp]) -> str:
    """The characters of a line; more than three equal ones in a row are written once, with their number before them."""
    starts = np.flatnonzero(np.diff(columns, prepend=-1))
    lengths = np.diff(np.append(starts, len(columns)))
    letters = (columns[starts] + 63).tolist()
    runs = [
        chr(letter) * length if length < 4 else f"!{length}{chr(letter)}"
        for letter, length in zip(letters, lengths.tolist(), strict=True)
    ]
    if runs and letters[-1] == 63:
        runs.pop()  # nothing to the right of the last
    return "".join(runs)
