# SPDX-License-Identifier: Apache-2.0
"""Colours on terminals that show them, unless $NO_COLOR (no-color.org) or $FORCE_COLOR says otherwise."""

from __future__ import annotations

import os
from typing import TextIO

_CODES = {"red": "31", "green": "32", "yellow": "33", "dim": "2"}  # SGR


def painted(text: str, colour: str, stream: TextIO | None) -> str:
    """`text` in one of `_CODES`, if `stream` shows colours."""
    return f"\x1b[{_CODES[colour]}m{text}\x1b[0m" if text and _shows(stream) else text


def _shows(stream: TextIO | None) -> bool:
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return stream is not None and stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"
