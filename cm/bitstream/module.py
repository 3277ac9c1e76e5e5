# SPDX-License-Identifier: Apache-2.0
"""Bitstreams of modules for the simulated board: what a module is travels in its frame data.

The first frame begins with a mark, a digest, and the module's name and model, so that the
simulated port knows from what was really loaded, not from a file's name, which module runs.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from cm.bitstream.assemble import FrameRun, assemble
from cm.bitstream.devices import Device, Family, device_by_name
from cm.bitstream.errors import UnknownDevice
from cm.bitstream.far import FrameAddress
from cm.schema.model import FrameRange

_MAGIC = b"CM-RM\0\0\1"
_LAYOUT = struct.Struct(">8s32sHH")  # mark, sha256 of the two names, length of name, of model
_NAMES = 256  # bytes that name and model may take together
_COLUMN_FRAMES = {Family.SERIES7: 36, Family.ULTRASCALE_PLUS: 16}  # frames of a CLB column
DEFAULT_SIZE = 128 * 1024


@dataclass(frozen=True, slots=True)
class ModuleIdentity:
    """Which module a bitstream of ours holds, and which model behaves like it."""

    name: str
    model: str


def _digest(name: bytes, model: bytes) -> bytes:
    return hashlib.sha256(name + b"\0" + model).digest()


def _identity_bytes(name: str, model: str) -> bytes:
    raw_name, raw_model = name.encode(), model.encode()
    if len(raw_name) + len(raw_model) > _NAMES:
        raise ValueError(f"module {name!r} and model {model!r}: together over {_NAMES} bytes")
    head = _LAYOUT.pack(_MAGIC, _digest(raw_name, raw_model), len(raw_name), len(raw_model))
    return head + raw_name + raw_model


def identify_words(words: Sequence[int]) -> ModuleIdentity | None:
    """Return the module that a frame's words name; None if they are no frame of our assembler."""
    return identify_bytes(struct.pack(f">{len(words)}I", *words))


def identify_bytes(data: bytes) -> ModuleIdentity | None:
    """The same for a frame's bytes as they stand in a `.bit`."""
    if len(data) < _LAYOUT.size or not data.startswith(_MAGIC):
        return None
    _, digest, name_length, model_length = _LAYOUT.unpack_from(data)
    end = _LAYOUT.size + name_length
    name, model = data[_LAYOUT.size : end], data[end : end + model_length]
    if len(name) + len(model) != name_length + model_length or digest != _digest(name, model):
        return None
    return ModuleIdentity(name.decode("utf-8", "replace"), model.decode("utf-8", "replace"))


def default_footprint(index: int, device: str | Device, size: int = DEFAULT_SIZE) -> tuple[FrameRange, ...]:
    """Return frames for the region with this index that overlap no other index's and hold `size` bytes."""
    family = _family(device)
    frames = -(-size // (4 * family.frame_words))
    last = -(-frames // _COLUMN_FRAMES[family]) - 1
    return (FrameRange(block_type=0, row=index, column_first=0, column_last=min(last, 1023)),)


def _family(device: str | Device) -> Family:
    found = device if isinstance(device, Device) else device_by_name(device)
    if found is None:
        raise UnknownDevice(f"device {device!r} has no IDCODE in cm.bitstream.devices; give a Device instead")
    return found.family


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
    family = _family(device)
    frame_bytes = 4 * family.frame_words
    columns = _columns(footprint or default_footprint(region_index, device, size))
    identity = _identity_bytes(name, model or name)
    wanted = max(1, min(-(-size // frame_bytes), len(columns) * _COLUMN_FRAMES[family]))
    filler = hashlib.shake_128(identity).digest(wanted * frame_bytes)
    data = identity + filler[len(identity) :]
    step = _COLUMN_FRAMES[family] * frame_bytes
    chunks = [data[start : start + step] for start in range(0, len(data), step)]
    # Each run ends with a frame of padding that only pushes the one before it out of the buffer.
    runs = [FrameRun(address, chunk + bytes(frame_bytes)) for address, chunk in zip(columns, chunks, strict=False)]
    return assemble(device, runs, design=name, part=part, crc=crc)
