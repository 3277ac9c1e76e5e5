# SPDX-License-Identifier: Apache-2.0
"""Moves a partial bitstream of a 7-series device to another region: other frame addresses, other checksums.

What a region's frames hold is the module and the static part's wires in the region, to its boundary above all. Those
stay where they are; where they are not the same in both regions, the module must leave them alone.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

from cm.device.native import bitstream as native
from cm.formats.bitstream.assemble import FrameRun, assemble
from cm.formats.bitstream.container import Container, Source, convert, open_image
from cm.formats.bitstream.errors import CannotRelocate
from cm.formats.bitstream.geometry import FrameAddress, Geometry, decode_far, encode_far, geometry_of
from cm.formats.bitstream.idcodes import Device, Family
from cm.formats.bitstream.memory import frames_in
from cm.formats.bitstream.merge import (
    Moves,
    check_clocks,
    check_kinds,
    check_wires,
    merge,
    module_of,
)
from cm.formats.bitstream.packets import TYPE1_LIMIT, Register, packet_events, type1, word_of
from cm.formats.xray import Database, to_bytes
from cm.formats.xray.frames import BYTES, ECC_MASK, Frames
from cm.schema.model import FrameRange

_FAR = type1(Register.FAR, 1)


def column_moves(device: Device, source: Sequence[FrameRange], target: Sequence[FrameRange]) -> Moves:
    """Return where each column of one region lies in another. Raises CannotRelocate with the first difference."""
    geometry = geometry_of(device.name)
    if device.family is not Family.SERIES7 or geometry is None:
        raise CannotRelocate(f"{device.name}: only 7-series devices whose columns are known are moved within")
    if [one.block_type for one in source] != [one.block_type for one in target]:
        raise CannotRelocate(f"the regions have {_kinds(source)} and {_kinds(target)} rows of columns")
    moves = {}
    for one, other in zip(sorted(source, key=_place), sorted(target, key=_place), strict=True):
        if _width(one) != _width(other):
            raise CannotRelocate(f"{_named(one)} are {_width(one)} columns, {_named(other)} are {_width(other)}")
        for number in range(_width(one)):
            here = FrameAddress(one.block_type, one.row, one.column_first + number)
            there = FrameAddress(other.block_type, other.row, other.column_first + number)
            before, after = geometry.frames(here), geometry.frames(there)
            if before != after or not before:
                raise CannotRelocate(
                    f"column kinds differ: column {here.column} of row {here.row} has {before} frames, "
                    f"column {there.column} of row {there.row} has {after}"
                )
            moves[encode_far(here, device.family)] = encode_far(there, device.family)
    return moves


def moved(frames: Frames, moves: Moves) -> dict[int, int]:
    """Return frames at their new addresses. Raises CannotRelocate for one that is not of the region."""
    found = {}
    for address, frame in frames.items():
        if address & ~0x7F not in moves:
            raise CannotRelocate(f"frame {address:08X} is not of the region that the bitstream is moved from")
        found[moves[address & ~0x7F] | address & 0x7F] = frame
    return found


def relocate(source: Source, moves: Moves, blank: Frames, database: Database) -> bytes:
    """Return the bitstream for another region, in the same container.

    `blank`: the frames of the whole device with the static part alone. Where both regions hold the same of it, only FAR
    and CRC are rewritten, and moving the result back gives the same bytes. Where they do
    not, the frames are made anew, of the module and of what the static part has there, if `database` knows of nothing
    against it. Raises CannotRelocate with the first difference, and the refusals of a bitstream that is not good.
    """
    device, frames = frames_in(source)
    wanted = moved(frames, moves)
    check_kinds(database, moves)
    here, there = ({at: blank.get(at, 0) for at in addresses} for addresses in (frames, wanted))
    module = moved(module_of(frames, here), moves)
    check_wires(database, module, moves)
    merged = merge(database, module, moved(here, moves), there)
    check_clocks(database, blank, module, moves)
    same = all((frame ^ wanted[address]) & ~ECC_MASK == 0 for address, frame in merged.items())
    return readdressed(source, moves) if same else _assembled(device, source, merged)


def _assembled(device: Device, source: Source, frames: Frames) -> bytes:
    """A partial bitstream of these frames with the header of another."""
    image, geometry = open_image(source), geometry_of(device.name)
    assert geometry is not None  # `column_moves` knew it
    runs = []
    for run in _in_runs(sorted(frames), geometry, device.family):
        data = b"".join(to_bytes(frames[address]) for address in run)
        runs.append(FrameRun(decode_far(run[0], device.family), data + bytes(BYTES)))
    return convert(assemble(device, runs), image.container, image.header)


def _in_runs(addresses: Sequence[int], geometry: Geometry, family: Family) -> list[list[int]]:
    """Frames that follow each other, also from column to column, as the port counts."""
    found: list[list[int]] = []
    for address in addresses:
        if not found or address != _after(found[-1][-1], geometry, family):
            found.append([])
        found[-1].append(address)
    return found


def _after(address: int, geometry: Geometry, family: Family) -> int:
    """The address of the next frame within its row."""
    at = decode_far(address, family)
    if at.minor + 1 < geometry.frames(at):
        return address + 1
    return encode_far(FrameAddress(at.block_type, at.row, at.column + 1), family)


def readdressed(source: Source, moves: Moves) -> bytes:
    """Return a bitstream with other frame addresses and the checksums that follow from them, and all else as it was.

    It is the caller's to know that the frames mean the same there. Raises CannotRelocate where they would not come to
    lie as they did, and the refusals of a bitstream that is not good.
    """
    wanted = moved(frames_in(source)[1], moves)
    image = open_image(source)
    if image.container is Container.BOOTGEN:
        raise CannotRelocate("boot images are read, not written: give the .bit or .bin")
    words = bytearray(convert(source, Container.BIN_STRAIGHT))
    for at in _far_writes(words):
        far = word_of(words, at)
        if far & ~0x7F in moves:
            struct.pack_into(">I", words, 4 * at, moves[far & ~0x7F] | far & 0x7F)
    for event in packet_events(open_image(bytes(words)), native.PacketProcessor()):
        if event.kind == native.CRC:
            struct.pack_into(">I", words, 4 * event.word + 4, event.count)
    result = convert(bytes(words), image.container, image.header)
    if frames_in(result)[1] != wanted:
        raise CannotRelocate("a run of frames goes over the end of its row, and would not do so in the other region")
    return result


def _far_writes(words: bytes | bytearray) -> Iterator[int]:
    """Where a good stream writes FAR: indices of its values. What stands outside of sync has no form of a write."""
    at = 0
    while 4 * at < len(words):
        header = word_of(words, at)
        at += 1
        if header == _FAR:
            yield at
        if header >> 29 == 1:
            at += header & TYPE1_LIMIT
        elif header >> 29 == 2:
            at += header & 0x7FFFFFF


def _place(item: FrameRange) -> tuple[int, int, int]:
    """In the order of the device from its bottom, so that regions of several rows keep it."""
    return item.block_type, -item.row if item.row & 32 else item.row, item.column_first


def _width(item: FrameRange) -> int:
    return item.column_last - item.column_first + 1


def _named(item: FrameRange) -> str:
    return f"columns {item.column_first}-{item.column_last} of row {item.row} (block type {item.block_type})"


def _kinds(items: Sequence[FrameRange]) -> str:
    return ", ".join(str(item.block_type) for item in items) or "no"
