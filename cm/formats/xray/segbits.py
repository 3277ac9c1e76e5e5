# SPDX-License-Identifier: Apache-2.0
"""segbits and ppips: which configuration bits each feature of a kind of tile has."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

from cm.formats.xray.features import XrayError

_INDEX = re.compile(r"\[0*(\d+)\]$")
_BIT = re.compile(r"(!?)(\d+)_(\d+)")


class Bit(NamedTuple):
    """A bit of a tile: frame from the first of its column, bit from the first of its words; and its value."""

    frame: int
    position: int
    value: bool


@dataclass(frozen=True)
class Segbits:
    """The features of one kind of tile in one block type, by name without the kind (``ALUT.INIT[5]``)."""

    features: Mapping[str, tuple[Bit, ...]]

    @cached_property
    def by_set_bit(self) -> Mapping[tuple[int, int], tuple[str, ...]]:
        """The features that want a bit (frame, position) to be 1."""
        found: dict[tuple[int, int], list[str]] = {}
        for name, bits in self.features.items():
            for bit in bits:
                if bit.value:
                    found.setdefault((bit.frame, bit.position), []).append(name)
        return {place: tuple(names) for place, names in found.items()}


def plain_name(name: str) -> str:
    """Return a feature's name with the number in brackets as it is counted: ``INIT[05]`` is ``INIT[5]``."""
    return _INDEX.sub(r"[\1]", name)


def read_segbits(path: Path) -> Segbits:
    """Read a ``segbits_*.db``; a file that is not there has no features. Raises XrayError with file and line."""
    features = {}
    for number, words in _lines(path):
        bits = tuple(_bit(text, f"{path}:{number}") for text in words[1:])
        features[plain_name(words[0].partition(".")[2])] = bits
    return Segbits(features)


def read_ppips(path: Path) -> Mapping[str, str]:
    """Read a ``ppips_*.db``: pips without bits, and whether they are ``always``, ``default`` or a ``hint``."""
    return {words[0].partition(".")[2]: words[1] for _, words in _lines(path) if len(words) == 2}


def _bit(text: str, where: str) -> Bit:
    found = _BIT.fullmatch(text)
    if found is None:
        raise XrayError(f"{where}: {text!r} is not a bit (FRAME_BIT or !FRAME_BIT)")
    return Bit(int(found[2]), int(found[3]), not found[1])


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    return [(number, words) for number, line in enumerate(text.splitlines(), 1) if (words := line.split())]
