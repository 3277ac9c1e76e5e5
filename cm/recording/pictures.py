# SPDX-License-Identifier: Apache-2.0
"""Data of frames as messages: pictures as foxglove.RawImage, which Foxglove shows, all others as cm.FrameData.

The bytes are the last field, so they are written from where they lie, behind what is encoded of the others.
"""

from __future__ import annotations

from cm.frozen import dataclass
from cm.recording.file import Schema
from cm.schema.pictures import implied_encoding
from cm.wire.messages.status import FrameInfo
from cm.wire.records import RAW_IMAGE, begin_bytes, encode_raw_image, raw_image_set

SCHEMA = Schema(RAW_IMAGE, "protobuf", raw_image_set())
_DATA_OF_IMAGE, _DATA = 6, 1  # numbers of the fields
_KNOWN = ("bgr8", "bgra8", "mono8", "mono16", "rgb8", "rgba8")  # of those that ours have, to Foxglove
_FORMATS = {"": None, "rgb": "rgb8", "bgr": "bgr8", "yuv422": "uyvy", "rbg": ""}


@dataclass(frozen=True, slots=True)
class Head:
    """What stands before a frame's bytes, and whether that makes it a picture."""

    data: bytes
    picture: bool


def encoding_of(info: FrameInfo) -> str:
    """Foxglove's name of a frame's pixels; empty if it has none."""
    if len(info.shape) not in (2, 3):
        return ""
    named = _FORMATS.get(info.format, "")
    found = implied_encoding(info.shape, info.dtype) if named is None else named
    found = {"16UC1": "mono16"}.get(found, found)
    return found if named or found in _KNOWN else ""


def head_of(info: FrameInfo, length: int, time_ns: int) -> Head:
    """What stands before `length` bytes of a frame."""
    encoding = encoding_of(info)
    rows = info.shape[0] if encoding else 0
    if not rows or length % rows:
        return Head(begin_bytes(_DATA, length), False)
    image = encode_raw_image(
        time_ns, frame_id=info.stream, width=info.shape[1], height=rows, encoding=encoding, step=length // rows
    )
    return Head(image + begin_bytes(_DATA_OF_IMAGE, length), True)
