# SPDX-License-Identifier: Apache-2.0
"""Features → frames → bitstreams: the full one of static part and first modules, a partial one of each module."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping

from cm.design.errors import BuildError
from cm.formats.bitstream import FrameAddress, FrameRun, assemble
from cm.formats.bitstream.geometry import Geometry, decode_far, encode_far, geometry_of
from cm.formats.bitstream.idcodes import Family
from cm.formats.xray import Database, Feature, encode, to_bytes, with_ecc

_MINOR_BITS = 7
_EMPTY = bytes(404)


def frames_of(database: Database, features: Iterable[Feature], what: str) -> dict[int, int]:
    """Return frames with checksums. Raises BuildError for features that are unknown or contradict each other."""
    encoded = encode(database, features)
    if encoded.unresolved:
        few = ", ".join(map(str, encoded.unresolved[:3]))
        raise BuildError(f"{what}: {len(encoded.unresolved)} features are not in the database: {few}")
    if encoded.clashes:
        raise BuildError(f"{what}: {len(encoded.clashes)} bits with two values: {encoded.clashes[0]}")
    return encoded.frames


def outside(columns: Iterable[int], one: Mapping[int, int], other: Mapping[int, int]) -> list[int]:
    """Addresses of the differing frames that lie outside the columns."""
    inside = set(columns)
    return sorted(
        address
        for address in one.keys() | other.keys()
        if address >> _MINOR_BITS not in inside and one.get(address, 0) != other.get(address, 0)
    )


def user_id(frames: Mapping[int, int]) -> int:
    """A number that identifies the static part, for the headers of all bitstreams that belong to it."""
    text = "".join(f"{address:08x}{frame:x};" for address, frame in sorted(frames.items()))
    return min(int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big"), 0xFFFF_FFFE)


def full_image(device: str, part: str, name: str, frames: Mapping[int, int], number: int) -> bytes:
    """Make a full bitstream: every frame of the device, in order of address, with padding after each row."""
    geometry = _geometry(device)
    data = bytearray()
    for key in sorted(key for key in geometry.rows if key[0] < 2):
        row = geometry.rows[key]
        for column in range(row.columns):
            data += _column(frames, FrameAddress(*key, column), row.frames(column))
        data += 2 * _EMPTY
    runs = [FrameRun(FrameAddress(0, 0, 0), bytes(data))]
    return assemble(device, runs, design=name, part=_short(part), partial=False, user_id=number)


def partial_image(
    device: str, part: str, name: str, frames: Mapping[int, int], columns: Iterable[int], number: int
) -> bytes:
    """Make a partial bitstream: every frame of the columns, in runs of neighbours, each followed by a padding frame."""
    geometry = _geometry(device)
    runs: list[FrameRun] = []
    for first, many in neighbours(sorted(columns)):
        address = decode_far(first << _MINOR_BITS, Family.SERIES7)
        row = geometry.row(address.block_type, address.row)
        if row is None:
            raise BuildError(f"{name}: {address} is not a column of {device}")
        places = [FrameAddress(address.block_type, address.row, address.column + more) for more in range(many)]
        data = b"".join(_column(frames, place, row.frames(place.column)) for place in places)
        runs.append(FrameRun(address, data + _EMPTY))
    return assemble(device, runs, design=name, part=_short(part), partial=True, user_id=number)


def _column(frames: Mapping[int, int], address: FrameAddress, count: int) -> bytes:
    first = encode_far(address, Family.SERIES7)
    return b"".join(to_bytes(with_ecc(frames.get(first + minor, 0))) for minor in range(count))


def neighbours(columns: list[int]) -> list[tuple[int, int]]:
    """Runs of consecutive columns: the first, and how many."""
    found: list[tuple[int, int]] = []
    for column in columns:
        if found and found[-1][0] + found[-1][1] == column:
            found[-1] = (found[-1][0], found[-1][1] + 1)
        else:
            found.append((column, 1))
    return found


def _geometry(device: str) -> Geometry:
    found = geometry_of(device)
    if found is None:
        raise BuildError(f"the columns of {device} are not known")
    return found


def _short(part: str) -> str:
    return part.removeprefix("xc").rpartition("-")[0]
