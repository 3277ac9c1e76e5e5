# SPDX-License-Identifier: Apache-2.0
"""Colours on terminals that show them, as $NO_COLOR (no-color.org), $FORCE_COLOR and ``--color WHEN`` have it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

_CODES = {"red": "31", "green": "32", "yellow": "33", "dim": "2"}  # SGR
_WHEN = {"auto": {}, "always": {"NO_COLOR": "", "FORCE_COLOR": "1"}, "never": {"NO_COLOR": "1", "FORCE_COLOR": ""}}


def painted(text: str, colour: str, stream: TextIO | None) -> str:
    """`text` in one of `_CODES`, if `stream` shows colours."""
    return f"\x1b[{_CODES[colour]}m{text}\x1b[0m" if text and _shows(stream) else text


def _shows(stream: TextIO | None) -> bool:
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return stream is not None and stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def colours_of(words: list[str]) -> tuple[list[str], str]:
    """A command line without ``--color WHEN``, which may stand anywhere in front of a ``--``; and WHEN, if it was said.

    A WHEN that there is none of stays, for the parser to refuse.
    """
    end = words.index("--") if "--" in words else len(words)
    for at, word in enumerate(words[:end]):
        name, equals, when = word.partition("=")
        length = 1 if equals else 2
        if name == "--color" and (equals or at + 1 < end):
            when = when if equals else words[at + 1]
            if when in _WHEN:
                return [*words[:at], *words[at + length :]], when
    return words, ""


@contextmanager
def as_told(when: str) -> Iterator[None]:
    """Within the block, colours as ``--color`` says; programs that are started have it from the environment."""
    told = _WHEN.get(when, {})
    before = {name: os.environ.get(name) for name in told}
    os.environ.update(told)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
