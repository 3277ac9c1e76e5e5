# SPDX-License-Identifier: Apache-2.0
"""The application under test: looks at each picture, and changes the hardware when it gets dark."""

from __future__ import annotations

import numpy as np

import cm

DARK = 60  # mean brightness


def drive(board: cm.Board, picture: np.ndarray) -> np.ndarray:
    """The region's result for a picture, in the mode that suits it."""
    wanted = "night" if picture.mean() < DARK else "day"
    if board.mode != wanted:
        board.mode = wanted
    with board.stream("from_vision", timeout=30) as back:
        board.write("to_vision", picture)
        return np.array(back.read())
