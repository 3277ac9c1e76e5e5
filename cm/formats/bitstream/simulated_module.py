# SPDX-License-Identifier: Apache-2.0
"""Bitstreams of modules for the simulated board: the frame data say which module it is.

The first frame begins with a mark, a digest, and the module's name and model, so that the simulated port knows which
module runs from what was really loaded, not from a file's name.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from itertools import accumulate

from cm.formats.bitstream.assemble import FrameRun, assemble
from cm.formats.bitstream.geometry import FrameAddress, geometry_of
from cm.formats.bitstream.idcodes import Device, Family, known_device
from cm.frozen import dataclass
from cm.hashes import sha256
from cm.schema.model import FrameRange

_MAGIC = b"CM-RM\0\0\1"
_LAYOUT = struct.Struct(">8s32sHH")  # mark, sha256 of the two names, length of name, of model
_NAMES = 256  # bytes that name and model may take together
_COLUMN_FRAMES = {Family.SERIES7: 36, Family.ULTRASCALE_PLUS: 16}  # of a CLB column, where nothing better is known
_COLUMNS = 1 << 10  # that a frame address can name
DEFAULT_SIZE = 128 * 1024


@dataclass(frozen=True, slots=True)
class ModuleIdentity:
    """Which module a bitstream of ours holds, and which model behaves like it."""

    name: str
    model: str


def _digest(name: bytes, model: bytes) -> bytes:
    return bytes.fromhex(sha256(name + b"\0" + model))


def _identity_bytes(name: str, model: str) -> bytes:
    raw_name, raw_model = name.encode(), model.encode()
    if len(raw_name) + len(raw_model) > _NAMES:
        raise ValueError(f"module {name!r} and model {model!r}: together over {_NAMES} bytes")
    head = _LAYOUT.pack(_MAGIC, _digest(raw_name, raw_model), len(raw_name), len(raw_model))
    return head + raw_name + raw_model


def identify_bytes(data: bytes) -> ModuleIdentity | None:
    """The module that a frame names, from its bytes as they stand in a `.bit`; None if it is not one of ours."""
    if len(data) < _LAYOUT.size or not data.startswith(_MAGIC):
        return None
    _, digest, name_length, model_length = _LAYOUT.unpack_from(data)
    end = _LAYOUT.size + name_length
    name, model = data[_LAYOUT.size : end], data[end : end + model_length]
    if digest != _digest(name, model):
        return None
    return ModuleIdentity(name.decode(errors="replace"), model.decode(errors="replace"))


def default_footprint(index: int, device: str | Device, size: int = DEFAULT_SIZE) -> tuple[FrameRange, ...]:
    """Return frames for the region with this index that overlap no other index's and hold `size` bytes."""
    known = known_device(device)
    left = size / (4 * known.family.frame_words)
    last, row = 0, _row(known, index)
    while left > (here := _column_frames(known, FrameAddress(0, row, last))) and last < _COLUMNS - 1:
        left -= here
        last += 1
    return (FrameRange(block_type=0, row=row, column_first=0, column_last=last),)


def _row(device: Device, index: int) -> int:
    """A row of the device for each region, as long as there are some; rows of the bottom half are 32 and up."""
    geometry = geometry_of(device.name)
    rows = sorted(row for block_type, row in geometry.rows if block_type == 0) if geometry else []
    return rows[index] if index < len(rows) else index


def _column_frames(device: Device, column: FrameAddress) -> int:
    """Return the frames of a column; those of a CLB column where the device is not known, or has no such row."""
    geometry = geometry_of(device.name)
    return (geometry.frames(column) if geometry else 0) or _COLUMN_FRAMES[device.family]


def _columns(footprint: Iterable[FrameRange]) -> list[FrameAddress]:
    return [
        FrameAddress(item.block_type, item.row, column)
        for item in footprint
        for column in range(item.column_first, item.column_last + 1)
    ]


def assemble_module(
    name: str,
    *,
    model: str | None = None,
    device: str | Device = "xc7z020",
    footprint: Sequence[FrameRange] = (),
    region_index: int = 0,
    size: int = DEFAULT_SIZE,
    part: str | None = None,
    crc: bool = True,
) -> bytes:
    """Return the `.bit` of a partial bitstream for the simulated board.

    `footprint` are the frames of its region (`default_footprint` of `region_index` if empty); the
    frame data takes about `size` bytes, but no more than the footprint holds, and depends on
    nothing but the arguments. Raises ValueError for names that fill more than a frame.
    """
    known = known_device(device)
    columns = _columns(footprint or default_footprint(region_index, known, size))
    frames = _share(-(-size // (4 * known.family.frame_words)), [_column_frames(known, column) for column in columns])
    identity = _identity_bytes(name, model or name)
    runs = _runs(identity, 4 * known.family.frame_words, list(zip(columns, frames, strict=False)))
    return assemble(known, runs, design=name, part=part, crc=crc)


def _share(wanted: int, there: Sequence[int]) -> list[int]:
    """Fill columns with that many frames from the first on, at least one in the first."""
    left = (max(1, wanted) - begin for begin in accumulate(there, initial=0))
    return [count for count in map(min, there, left) if count > 0]


def _runs(identity: bytes, frame_bytes: int, columns: Sequence[tuple[FrameAddress, int]]) -> list[FrameRun]:
    """One run for each column; each ends with a padding frame that only pushes the one before it out."""
    import hashlib  # here: see cm.hashes

    total = sum(frames for _, frames in columns) * frame_bytes
    data = memoryview(identity + hashlib.shake_128(identity).digest(total)[len(identity) :])
    runs, at = [], 0
    for address, frames in columns:
        end = at + frames * frame_bytes
        runs.append(FrameRun(address, bytes(data[at:end]) + bytes(frame_bytes)))
        at = end
    return runs
