# SPDX-License-Identifier: Apache-2.0
"""The terminal: what it can draw, which it is asked itself, and how large it is."""

from __future__ import annotations

import fcntl
import os
import re
import select
import struct
import termios
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from cm.cli.drawing import kitty

_ANSWER = 1.0  # seconds in which a terminal answers, even over a slow line
_ATTRIBUTES = "\x1b[c"  # DA1: every terminal answers this, so we need not wait for answers that some never send
_CELL = "\x1b[16t"  # pixels of a cell (xterm's "Window manipulation")
_LAST = re.compile(rb"\x1b\[\?([\d;]*)c")
_SIXEL = "4"  # among the attributes
DEFAULT_CELL = (10, 20)


@dataclass(frozen=True, slots=True)
class Size:
    """Columns and rows of cells, and the pixels of one."""

    columns: int
    rows: int
    cell: tuple[int, int] = DEFAULT_CELL


@dataclass(frozen=True, slots=True)
class Ability:
    """How a terminal can draw: kitty, sixel or blocks; `cell` is its size in pixels, if the terminal said so."""

    way: str = "blocks"
    cell: tuple[int, int] | None = None


def understood(answer: bytes) -> Ability:
    """What a terminal's answers to our questions mean."""
    cell = re.search(rb"\x1b\[6;(\d+);(\d+)t", answer)
    size = (int(cell[2]), int(cell[1])) if cell and int(cell[1]) and int(cell[2]) else None
    attributes = _LAST.search(answer)
    if re.search(rb"\x1b_Gi=31;OK\x1b\\", answer):
        return Ability("kitty", size)
    if attributes and _SIXEL in attributes[1].decode("ascii").split(";")[1:]:
        return Ability("sixel", size)
    return Ability("blocks", size)


def asked(descriptor: int) -> Ability:
    """What the terminal behind a descriptor can do; its keys must not be read by others meanwhile."""
    os.write(descriptor, f"{kitty.QUERY}{_CELL}{_ATTRIBUTES}".encode())
    answer, end = b"", time.monotonic() + _ANSWER
    while not _LAST.search(answer) and (left := end - time.monotonic()) > 0:
        if not select.select([descriptor], [], [], left)[0]:
            break
        answer += os.read(descriptor, 4096)
    return understood(answer)


def has_true_colour(environment: Mapping[str, str]) -> bool:
    """Whether the terminal takes colours of 24 bits, as far as the environment says."""
    said = environment.get("COLORTERM", "").lower()
    return said in ("truecolor", "24bit") or environment.get("TERM", "").endswith("-direct")


def size_of(descriptor: int, cell: tuple[int, int] | None = None) -> Size:
    """How large a terminal is now. Raises OSError for what is not a terminal."""
    rows, columns, width, height = struct.unpack("HHHH", fcntl.ioctl(descriptor, termios.TIOCGWINSZ, bytes(8)))
    columns, rows = columns or 80, rows or 24
    if cell is None and width and height:
        cell = (max(1, width // columns), max(1, height // rows))
    return Size(columns, rows, cell or DEFAULT_CELL)


@contextmanager
def keys_as_they_come(descriptor: int) -> Iterator[None]:
    """Keys are delivered at once and not shown; Ctrl-C works as always."""
    before = termios.tcgetattr(descriptor)
    try:
        attributes = termios.tcgetattr(descriptor)
        attributes[3] &= ~(termios.ECHO | termios.ICANON)  # lflag
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        yield
    finally:
        termios.tcsetattr(descriptor, termios.TCSANOW, before)
