# SPDX-License-Identifier: Apache-2.0
"""Where configuration words begin: the sync word, in either byte order."""

from __future__ import annotations

_SYNC_BIG = bytes.fromhex("aa995566")
_SYNC_LITTLE = bytes.fromhex("665599aa")
SEARCH = 1 << 16  # bytes: in a plain .bin the sync word stands within the first few hundred


def find_sync(data: memoryview, start: int, end: int) -> tuple[int, bool]:
    """Return where the first word-aligned sync word is, and whether it is swapped; -1 if there is none."""
    found = []
    window = bytes(data[start:end])
    for pattern, swapped in ((_SYNC_BIG, False), (_SYNC_LITTLE, True)):
        at = window.find(pattern)
        while at >= 0 and at % 4:
            at = window.find(pattern, at + 1)
        if at >= 0:
            found.append((start + at, swapped))
    return min(found, default=(-1, False))


def whole_words(data: memoryview) -> tuple[memoryview, int]:
    """Return the words of `data`, and how many bytes of one more there are."""
    rest = len(data) % 4
    return (data[: len(data) - rest], rest) if rest else (data, 0)
