# SPDX-License-Identifier: Apache-2.0
"""Frames → features."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import takewhile

from cm.formats.xray.database import Database
from cm.formats.xray.features import Feature
from cm.formats.xray.frames import ECC_MASK, Frames, set_bits
from cm.formats.xray.tiles import Segment, Tile
from cm.frozen import dataclass


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
