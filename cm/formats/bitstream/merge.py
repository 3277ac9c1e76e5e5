# SPDX-License-Identifier: Apache-2.0
"""Whether a module that is moved, and the static part of its new region, can be together: what the database knows."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import TypeAlias

from cm.formats.bitstream.errors import CannotRelocate
from cm.formats.xray import Database, Feature, Tile, Wires, decode, set_bits, two_drivers, with_ecc
from cm.formats.xray.frames import ECC_MASK, Frames
from cm.formats.xray.wires import Wire

Moves: TypeAlias = Mapping[int, int]  # address of a column's first frame → that of the column which it becomes
_LINE = re.compile(r"HCLK_CK_BUFHCLK(\d+)$")  # a line of the clock row
_CLOCK_LINES = 12
_SWITCHES = ("INT_", "HCLK_")  # tiles whose features are pips between wires


def module_of(frames: Frames, blank: Frames) -> dict[int, int]:
    """What a module adds to the static part. Raises CannotRelocate if it does not belong to this static part."""
    for address, frame in frames.items():
        lost = blank[address] & ~frame & ~ECC_MASK
        if lost:
            raise CannotRelocate(
                f"frame {address:08X} lacks {_bit(next(set_bits(lost)))}, which the static part sets there: the "
                "bitstream was made for another one"
            )
    return {address: frame & ~blank[address] & ~ECC_MASK for address, frame in frames.items()}


def merge(database: Database, module: Frames, before: Frames, blank: Frames) -> dict[int, int]:
    """A module in the static part of its new region; `before`: what that of its old one had, at the same addresses.

    Raises CannotRelocate where one is in the way of the other, and where the module had something of the old one.
    """
    merged = {address: with_ecc(frame | blank[address]) for address, frame in module.items()}
    found = decode(database, merged).features
    own, there = decode(database, module).features, decode(database, blank).features
    apart = own | there
    told = [*two_drivers(database, found), *_missed(database, own, decode(database, before).features - there)]
    for one in sorted(found ^ apart):
        told.append(f"{one} is {'there' if one in found else 'not there any more'} once both are")
    for address, frame in module.items():
        if frame & blank[address] & ~ECC_MASK:
            told.append(f"{_bit(next(set_bits(frame & blank[address])))} of frame {address:08X} is set by both")
    if told:
        more = f", and {len(told) - 1} more" if told[1:] else ""
        raise CannotRelocate(f"the module and the static part are in each other's way there: {told[0]}{more}")
    return merged


def check_wires(database: Database, module: Frames, moves: Moves) -> None:
    """Raise CannotRelocate at the first wire of a module that has other ends in its new region, or leads out of it.

    At the edge of the device, wires that would lead out turn back. `module` is at its new addresses.
    """
    wires, columns = Wires(database), set(moves.values())
    back = {other: one for one, other in moves.items()}
    inside = {tile.name: tile for tile in database.tiles.values() if any(s.base in columns for s in tile.segments)}
    places = {(s.base, s.offset, tile.kind): name for name, tile in database.tiles.items() for s in tile.segments}
    before = {
        name: places[back[s.base], s.offset, tile.kind]
        for name, tile in inside.items()
        for s in tile.segments
        if s.base in back
    }
    region = set(before.values())
    for tile, name in sorted(decode(database, module).features):
        wire = name.partition(".")[0]
        if not tile.startswith("INT_") or wire not in wires.kind(database.tiles[tile].kind).wires:
            continue
        there = wires.node(tile, wire)
        out = sorted(at for at, _ in there if at not in inside and at.startswith("INT_"))
        if out:
            raise CannotRelocate(f"wire {wire} of {tile}, which the module uses, leads out of the region: to {out[0]}")
        ends = {(before[at], end) for at, end in there if at in inside}
        if ends != {(at, end) for at, end in wires.node(before[tile], wire) if at in region}:
            raise CannotRelocate(f"wire {wire} of {tile}, which the module uses, has other ends there")


def _missed(database: Database, module: frozenset[Feature], gone: frozenset[Feature]) -> list[str]:
    """Sentences about what only the old static part switched on, and a pip of the module comes from: clock leaves."""
    wires = Wires(database)
    sources: set[Wire] = set()
    for tile, name in module:
        if tile.startswith(_SWITCHES):
            sources |= _behind(database, wires, tile, name.partition(".")[2])
    lines = {(one.tile, one.name.partition(".")[2]) for one in module}
    found = []
    for one in sorted(gone):
        into, _, source = one.name.partition(".")
        enables = into == "ENABLE_BUFFER" and (one.tile, source) in lines
        if one.tile.startswith(_SWITCHES) and (enables or (one.tile, into) in sources):
            found.append(f"the module needs {one}, which the static part of its old region has")
    return found


def _behind(database: Database, wires: Wires, tile: str, wire: str) -> set[Wire]:
    """A wire in all its tiles, and what always leads to it."""
    found: set[Wire] = set()
    todo = [(tile, wire)] if wire in wires.kind(database.tiles[tile].kind).wires else []
    while todo:
        node = wires.node(*todo.pop())
        found |= node
        for there, name in node:
            for pip, when in database.ppips(database.tiles[there].kind).items() if there.startswith(_SWITCHES) else ():
                into, _, source = pip.partition(".")
                if into == name and when == "always" and (there, source) not in found:
                    todo.append((there, source))
    return found


def check_kinds(database: Database, moves: Moves) -> None:
    """Raise CannotRelocate at the first column whose tiles are of other kinds than those of the column it becomes."""
    tiles: defaultdict[int, set[tuple[int, str]]] = defaultdict(set)
    for tile in database.tiles.values():
        for segment in tile.segments:
            tiles[segment.base].add((segment.offset, tile.kind))
    for one, other in sorted(moves.items()):
        differs = sorted(tiles[one] ^ tiles[other])
        if differs:
            word = differs[0][0]
            kinds = [_told(kind for at, kind in tiles[base] if at == word) for base in (one, other)]
            raise CannotRelocate(
                f"column kinds differ: at word {word} of frame {one:08X} lies {kinds[0]}, of {other:08X} {kinds[1]}"
            )


def check_clocks(database: Database, blank: Frames, module: Frames, moves: Moves) -> None:
    """Raise CannotRelocate if a line of the clock row that the module uses is driven by another clock there."""
    rows = {
        one: other
        for one, other in zip(_clock_rows(moves.keys()), _clock_rows(moves.values()), strict=True)
        if one != other
    }
    if not rows:
        return
    used = {(tile, line) for tile, name in decode(database, module).features for line in _lines(tile, name)}
    spine = {
        base >> 17: tile
        for tile in database.tiles.values()
        if tile.kind.startswith("CLK_HROW")
        for base in (segment.base for segment in tile.segments)
    }
    spoken = decode(database, blank, [tile.name for tile in spine.values()]).features
    for one, other in rows.items():
        for tile, number in sorted(used):
            at = database.tiles[tile]
            if not any(segment.base >> 17 == other for segment in at.segments):
                continue
            drives = [_drivers(spoken, spine[row], number, at.x < spine[row].x) for row in (one, other)]
            if drives[0] != drives[1]:
                raise CannotRelocate(
                    f"line {number} of the clock row at {tile} is driven by {_told(drives[1])}, where the module comes "
                    f"from by {_told(drives[0])}"
                )


def _lines(tile: str, name: str) -> Iterable[int]:
    """The lines of the clock row that a feature may have to do with: a leaf of another source may be of any."""
    if not tile.startswith("HCLK_"):
        return ()
    found = _LINE.search(name)
    return (int(found[1]),) if found else range(_CLOCK_LINES)


def _drivers(features: frozenset[Feature], spine: Tile, number: int, left: bool) -> frozenset[str]:
    side = "L" if left else "R"
    starts = (f"CLK_HROW_CK_MUX_OUT_{side}{number}.", f"BUFHCE.BUFHCE_X{int(not left)}Y{number}.")
    return frozenset(one.name for one in features if one.tile == spine.name and one.name.startswith(starts))


def _clock_rows(columns: Iterable[int]) -> list[int]:
    """The clock rows of columns of logic, with their half."""
    return list(dict.fromkeys(column >> 17 for column in columns if not column >> 23 & 7))


def _bit(position: int) -> str:
    return f"bit {position % 32} of word {position // 32}"


def _told(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"
