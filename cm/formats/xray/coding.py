# SPDX-License-Identifier: Apache-2.0
"""Features → frames, and frames → features."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import takewhile

from cm.formats.xray.database import Database
from cm.formats.xray.features import Feature
from cm.formats.xray.frames import ECC_MASK, Frames, set_bits, with_ecc
from cm.formats.xray.tiles import Segment, Tile
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


@dataclass(frozen=True, slots=True)
class Decoded:
    """All features whose bits have the required values, and the set bits that no feature explains.

    These bits are (frame address, position). A feature with no bit that must be 1 cannot be told from one that was
    never set, and is not listed; nor are pips without bits. Features whose bits are part of another's are listed beside
    it.
    """

    features: frozenset[Feature]
    unexplained: frozenset[tuple[int, int]]


def decode(database: Database, frames: Frames, tiles: Iterable[str] | None = None) -> Decoded:
    """Return what frames say, ignoring checksums; `tiles` (all by default) are the tiles that are looked at."""
    chosen = database.tiles.values() if tiles is None else [database.tiles[name] for name in tiles]
    left = {address: frame & ~ECC_MASK for address, frame in frames.items()}
    found = set()
    for tile in chosen:
        for segment in tile.segments:
            for name, bits in _matches(database, frames, segment):
                found.add(Feature(tile.name, name))
                for address, position in bits:
                    left[address] &= ~(1 << position)
    unexplained = {(address, position) for address, frame in left.items() for position in set_bits(frame)}
    return Decoded(frozenset(found), frozenset(unexplained))


def tiles_with_bits(database: Database, addresses: Iterable[int]) -> Iterator[Tile]:
    """The tiles that have a configuration bit in any of these frames."""
    wanted = set(addresses)
    for tile in database.tiles.values():
        if any(not wanted.isdisjoint(range(segment.base, segment.base + segment.frames)) for segment in tile.segments):
            yield tile


def describe_bits(database: Database, bits: Iterable[tuple[int, int]]) -> Mapping[tuple[int, int], str]:
    """Say what each bit (frame address, position) belongs to: its tile, and the beginning of its features' names.

    A bit of a tile for which no feature is known has the tile alone; one that no tile has is left out.
    """
    frames: dict[int, list[int]] = {}
    for address, position in bits:
        frames.setdefault(address, []).append(position)
    found: dict[tuple[int, int], str] = {}
    for tile in database.tiles.values():
        for segment in tile.segments:
            for address in frames.keys() & set(range(segment.base, segment.base + segment.frames)):
                for position in frames[address]:
                    if segment.offset <= position // 32 < segment.offset + segment.words:
                        what = _common(database, segment, (address - segment.base, position - segment.shift))
                        place = f"{tile.name} {what}".rstrip()
                        found[address, position] = max(found.get((address, position), ""), place, key=len)
    return found


def _common(database: Database, segment: Segment, place: tuple[int, int]) -> str:
    """What all features of a bit begin with, in whole words: ``SLICEL_X0.BLUT.INIT[3]``, or the wire of a switch."""
    names = [
        segment.from_kind(name).split(".")
        for name, bits in database.segbits(segment.kind, segment.block).features.items()
        if any((bit.frame, bit.position) == place for bit in bits)
    ]
    return ".".join(parts[0] for parts in takewhile(lambda parts: len(set(parts)) == 1, zip(*names, strict=False)))


def _matches(database: Database, frames: Frames, segment: Segment) -> Iterator[tuple[str, list[tuple[int, int]]]]:
    """The features of a segment that hold, with their set bits as (frame address, position)."""
    own = _segment_bits(frames, segment)
    if not any(own.values()):
        return
    table = database.segbits(segment.kind, segment.block)
    shift = segment.shift
    candidates = {
        name
        for frame, bits in own.items()
        for position in set_bits(bits)
        for name in table.by_set_bit.get((frame, position), ())
    }
    for name in candidates:
        wanted = table.features[name]
        if all(own.get(bit.frame, 0) >> bit.position & 1 == bit.value for bit in wanted):
            ones = [(segment.base + bit.frame, bit.position + shift) for bit in wanted if bit.value]
            yield segment.from_kind(name), ones


def _segment_bits(frames: Frames, segment: Segment) -> dict[int, int]:
    """The bits of a segment by its frame, positions as the segbits count them."""
    low = 32 * segment.offset
    mask = (1 << 32 * segment.words) - 1
    found = {}
    for frame in range(segment.frames):
        whole = frames.get(segment.base + frame)
        if whole:
            found[frame] = (whole & ~ECC_MASK) >> low & mask
            if segment.start:
                found[frame] <<= 32 * segment.start
    return found
