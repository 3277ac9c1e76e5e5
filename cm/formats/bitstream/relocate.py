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
from cm.formats.bitstream.packets import SYNC, Command, Register, packet_events
from cm.formats.xray import Database, to_bytes
from cm.formats.xray.frames import BYTES, ECC_MASK, Frames
from cm.schema.model import FrameRange


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
            rows = [geometry.row(at.block_type, at.row) for at in (here, there)]
            counts = [row.frames(at.column) if row else 0 for row, at in zip(rows, (here, there), strict=True)]
            if counts[0] != counts[1] or not counts[0]:
                raise CannotRelocate(
                    f"column kinds differ: column {here.column} of row {here.row} has {counts[0]} frames, "
                    f"column {there.column} of row {there.row} has {counts[1]}"
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
    for far, order in _in_runs(sorted(frames), geometry, device.family):
        data = b"".join(to_bytes(frames[address]) for address in order)
        runs.append(FrameRun(decode_far(far, device.family), data + bytes(BYTES)))
    return convert(assemble(device, runs), image.container, image.header)


def _in_runs(addresses: Sequence[int], geometry: Geometry, family: Family) -> list[tuple[int, list[int]]]:
    """Frames that follow each other, also from column to column, as the port counts: the first, and all."""
    found: list[tuple[int, list[int]]] = []
    after = -1
    for address in addresses:
        if address == after:
            found[-1][1].append(address)
        else:
            found.append((address, [address]))
        at = decode_far(address, family)
        row = geometry.row(at.block_type, at.row)
        last = row is not None and at.minor + 1 == row.frames(at.column)
        after = encode_far(FrameAddress(at.block_type, at.row, at.column + 1), family) if last else address + 1
    return found


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
    checks = []
    for at, register in _writes(words):
        (value,) = struct.unpack_from(">I", words, 4 * at)
        if register == Register.FAR and value & ~0x7F in moves:
            struct.pack_into(">I", words, 4 * at, moves[value & ~0x7F] | value & 0x7F)
        elif register == Register.CRC:
            checks.append(at)
    events = packet_events(open_image(bytes(words)), native.PacketProcessor())
    for at, event in zip(checks, (event for event in events if event.kind == native.CRC), strict=True):
        struct.pack_into(">I", words, 4 * at, event.count)
    result = convert(bytes(words), image.container, image.header)
    if frames_in(result)[1] != wanted:
        raise CannotRelocate("a run of frames goes over the end of its row, and would not do so in the other region")
    return result


def _writes(words: bytes | bytearray) -> Iterator[tuple[int, int]]:
    """The writes of a good stream: index of the first word of data, register."""
    at, end, inside, register = 0, len(words) // 4, False, 0
    while at < end:
        (header,) = struct.unpack_from(">I", words, 4 * at)
        at += 1
        if not inside:
            inside = header == SYNC
            continue
        kind, count = header >> 29, 0
        if kind == 1 and header >> 27 & 3:
            register, count = header >> 13 & 0x1F, header & 0x7FF
        elif kind == 2:
            count = header & 0x7FFFFFF
        else:
            continue
        if count:
            yield at, register
        if register == Register.CMD and count and struct.unpack_from(">I", words, 4 * at) == (Command.DESYNC,):
            inside = False
        at += count


def _place(item: FrameRange) -> tuple[int, int, int]:
    """In the order of the device from its bottom, so that regions of several rows keep it."""
    return item.block_type, -(item.row & 31) if item.row & 32 else item.row + 1, item.column_first


def _width(item: FrameRange) -> int:
    return item.column_last - item.column_first + 1


def _named(item: FrameRange) -> str:
    return f"columns {item.column_first}-{item.column_last} of row {item.row} (block type {item.block_type})"


def _kinds(items: Sequence[FrameRange]) -> str:
    return ", ".join(str(item.block_type) for item in items) or "no"
