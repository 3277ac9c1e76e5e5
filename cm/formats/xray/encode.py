# SPDX-License-Identifier: Apache-2.0
"""Features → frames."""

from __future__ import annotations

from collections.abc import Iterable

from cm.formats.xray.database import Database
from cm.formats.xray.features import Feature
from cm.formats.xray.frames import with_ecc
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Clash:
    """A bit that one feature wants to be 1 and another 0."""

    address: int
    position: int
    one: Feature
    zero: Feature

    def __str__(self) -> str:
        word, bit = divmod(self.position, 32)
        return f"{self.one} sets bit {bit} of word {word} of frame {self.address:08X}, {self.zero} clears it"


@dataclass(frozen=True, slots=True)
class Encoded:
    """Frames by address, with checksums if `encode` was asked for them; frames without a set bit are left out.

    `unresolved` are features that the database does not know, `clashes` bits with two values: both must be
    empty for the frames to mean what the features say.
    """

    frames: dict[int, int]
    unresolved: tuple[Feature, ...]
    clashes: tuple[Clash, ...]


def encode(database: Database, features: Iterable[Feature], *, ecc: bool = True) -> Encoded:
    """Return the frames of features. Pips without bits are known and set nothing."""
    ones: dict[tuple[int, int], Feature] = {}
    zeros: list[tuple[tuple[int, int], Feature]] = []
    unresolved = []
    for feature in sorted(set(features)):
        bits = bits_of(database, feature)
        if bits is None:
            unresolved.append(feature)
            continue
        for place, value in bits:
            if value:
                ones.setdefault(place, feature)
            else:
                zeros.append((place, feature))
    frames: dict[int, int] = {}
    for address, position in ones:
        frames[address] = frames.get(address, 0) | 1 << position
    if ecc:
        frames = {address: with_ecc(frame) for address, frame in frames.items()}
    clashes = tuple(Clash(*place, ones[place], feature) for place, feature in zeros if place in ones)
    return Encoded(frames, tuple(unresolved), clashes)


def bits_of(database: Database, feature: Feature) -> list[tuple[tuple[int, int], bool]] | None:
    """Return ((frame address, bit of the frame), value) of a feature; None for one that the database does not have."""
    tile = database.tiles.get(feature.tile)
    if tile is None:
        return None
    found = None
    for segment in tile.segments:
        name = segment.to_kind(feature.name)
        bits = database.segbits(segment.kind, segment.block).features.get(name)
        if bits is not None and all(segment.holds(bit) for bit in bits):
            shift = segment.shift
            found = [((segment.base + bit.frame, bit.position + shift), bit.value) for bit in bits]
    if found is None and feature.name in database.ppips(tile.kind):
        return []
    return found
