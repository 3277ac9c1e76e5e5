# SPDX-License-Identifier: Apache-2.0
"""The contact sheet: what came out in each mode, a row a mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

Picture = np.ndarray[Any, np.dtype[np.uint8]]

_WIDTH, _MARGIN, _TEXT = 320, 12, 26
_BACKGROUND, _INK = (24, 26, 30), (230, 230, 230)


def contact_sheet(rows: Mapping[str, Sequence[Picture]], path: Path) -> None:
    """Write a PNG with a row of pictures under each label. Pictures are (H, W) grey or (H, W, 3) RGB."""
    first = next(iter(rows.values()))[0]
    height = _WIDTH * first.shape[0] // first.shape[1]
    columns = max(len(pictures) for pictures in rows.values())
    size = (_MARGIN + columns * (_WIDTH + _MARGIN), _MARGIN + len(rows) * (_TEXT + height + _MARGIN))
    sheet = Image.new("RGB", size, _BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for row, (label, pictures) in enumerate(rows.items()):
        top = _MARGIN + row * (_TEXT + height + _MARGIN)
        draw.text((_MARGIN, top + 4), label, fill=_INK)
        for column, picture in enumerate(pictures):
            small = Image.fromarray(picture).convert("RGB").resize((_WIDTH, height), Image.Resampling.LANCZOS)
            sheet.paste(small, (_MARGIN + column * (_WIDTH + _MARGIN), top + _TEXT))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
