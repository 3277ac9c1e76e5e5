# SPDX-License-Identifier: Apache-2.0
"""Checks what `cm_data_config` asks of a stream against what its channel can do; touches no device."""

from __future__ import annotations

import math

from cm.device import DmaCaps, DmaInfo, DmaType
from cm.device.data_plane import StreamSetup
from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.schema.model import ITEM_BYTES, Direction, Stream
from cm.schema.pictures import format_misfit, pixel_shape
from cm.wire.messages.requests import ConfigureStream
from cm.wire.plane_packets import DIMENSIONS, SLOTS_MAX

_MAX_FRAME = 1 << 30
_LENGTH_BITS = 26  # of an AXI DMA's length register at most (PG021)
_SLOT = 1 << 20  # bytes where neither schema nor channel says how long a frame is


def changed(stream: Stream, request: ConfigureStream) -> Stream:
    """Return the stream with the requested settings. Raises InvalidRequest, which says what would be right."""
    if request.direction and request.direction.lower() != stream.direction.value:
        raise InvalidRequest(f"stream {stream.name!r} is {stream.direction.value}, not {request.direction!r}")
    if request.rate < 0 or math.isnan(request.rate):
        raise InvalidRequest(f"stream {stream.name!r}: {request.rate} frames per second; a limit is positive")
    if not 0 <= request.slots <= SLOTS_MAX:
        raise InvalidRequest(f"stream {stream.name!r}: {request.slots} slots; 1 to {SLOTS_MAX} can be had")
    if request.cyclic and stream.direction is Direction.S2MM:
        raise InvalidRequest(f"stream {stream.name!r} cannot be cyclic: only a written frame is repeated")
    result = replace(
        stream,
        shape=pixel_shape(request.shape or stream.shape, stream.format),
        dtype=request.dtype or stream.dtype,
        slots=request.slots or stream.slots,
        limit=(None if math.isinf(request.rate) else request.rate) if request.rate else stream.limit,
        cyclic=stream.cyclic if request.cyclic is None else request.cyclic,
        backpressure=stream.backpressure if request.backpressure is None else request.backpressure,
        stride=request.stride or stream.stride,
    )
    _check(result)
    return result


def _check(stream: Stream) -> None:
    """Raise InvalidRequest for a geometry that no channel supports."""
    name, shape = f"stream {stream.name!r}", stream.shape
    problem = format_misfit(stream.format, shape, stream.dtype) if stream.format is not None else ""
    if problem:
        raise InvalidRequest(f"{name}: {problem}")
    if shape is not None and (len(shape) > DIMENSIONS or min(shape) < 1):
        raise InvalidRequest(f"{name}: no frame has the shape {shape}; 1 to {DIMENSIONS} extents of at least 1 go")
    if frame_bytes(stream) > _MAX_FRAME:
        raise InvalidRequest(f"{name}: a frame of shape {shape} has more than 1 GiB")
    lines, line_bytes = _lines(stream)
    if stream.stride and not lines:
        raise InvalidRequest(f"{name} has a stride, but no shape of lines and columns")
    if stream.stride and stream.stride < line_bytes:
        raise InvalidRequest(
            f"{name}: lines of {line_bytes} bytes do not fit a stride of {stream.stride}; "
            f"give a stride of {line_bytes} (none apart) or more"
        )
    if stream.stride and lines * stream.stride > 2 * _MAX_FRAME:
        raise InvalidRequest(f"{name}: {lines} lines with a stride of {stream.stride} take more than 2 GiB")


def longest(info: DmaInfo, stream: Stream) -> int:
    """Bytes of one transfer at most: what the channel says, and the schema of the engine."""
    return min(info.max_length, stream.max_length or info.max_length)


def setup(info: DmaInfo, stream: Stream) -> StreamSetup:
    """Return how a stream runs over a channel. Raises InvalidRequest for what the channel cannot do."""
    _check(stream)
    info = replace(info, max_length=longest(info, stream))
    name, frame = f"stream {stream.name!r}", frame_bytes(stream)
    write = stream.direction is Direction.MM2S
    lines, line_bytes = _lines(stream)
    stride = stream.stride or line_bytes
    video = lines > 0 and (info.type is DmaType.VDMA or stride != line_bytes)
    if info.type is DmaType.VDMA and not video:
        raise InvalidRequest(f"{name}: channel {info.name} is a VDMA's: its frames have a shape of lines and columns")
    if video and not info.caps & DmaCaps.VIDEO:
        raise InvalidRequest(f"{name} has a stride, but channel {info.name} knows no lines")
    # Input cycles through the slots anyway; the hardware must not do so by itself, because readers may hold a slot.
    cyclic = stream.cyclic and write
    if cyclic and not video and not info.caps & DmaCaps.CYCLIC:
        raise InvalidRequest(f"{name} cannot be cyclic: channel {info.name} cannot repeat a transfer")
    if not (write or frame or info.frame_length or info.tells_length):
        raise InvalidRequest(
            f"{name} has no shape, and channel {info.name} cannot tell how many bytes arrived: "
            "give the stream the shape of its frames, each of which must end with TLAST"
        )
    length = frame or stream.slot_bytes or info.frame_length or min(_SLOT, info.max_length)
    one, what = (line_bytes, "a line") if video else (length, "a frame")
    if one > info.max_length:
        wider, bits = "", one.bit_length()
        if info.type is DmaType.AXIDMA and bits <= _LENGTH_BITS:
            wider = f"; its design would need a 'Width of Buffer Length Register' of {bits} bits or more"
        raise InvalidRequest(
            f"{name}: {what} has {one} bytes, channel {info.name} moves {info.max_length} at most{wider}"
        )
    if video:
        length = (lines - 1) * stride + line_bytes
    _check_alignment(info, stream, one, stride if video else 0)
    period = round(1e9 / stream.limit) if stream.limit else 0
    shape = (lines, line_bytes, stride) if video else (0, 0, 0)
    return StreamSetup(write, length, stream.backpressure, cyclic, *shape, period)


def _check_alignment(info: DmaInfo, stream: Stream, one: int, stride: int) -> None:
    """Raise InvalidRequest for unaligned lengths, which the kernel's driver would refuse at every transfer."""
    step = max(1, info.alignment)
    for what, value in (("lines" if stride else "frames", one), ("a stride", stride)):
        if value % step:
            raise InvalidRequest(
                f"stream {stream.name!r}: {what} of {value} bytes; channel {info.name} takes multiples of {step}"
            )


def _lines(stream: Stream) -> tuple[int, int]:
    """Return the lines of a frame and the bytes of a line; 0, 0 for a frame without lines."""
    if stream.shape is None or len(stream.shape) < 2:
        return 0, 0
    return stream.shape[0], frame_bytes(stream) // stream.shape[0]


def frame_bytes(stream: Stream) -> int:
    """Bytes of one frame; 0 if the schema gives no shape. Raises InvalidRequest for a dtype that is not known."""
    item = ITEM_BYTES.get(stream.dtype)
    if item is None:
        raise InvalidRequest(f"stream {stream.name!r}: no dtype {stream.dtype!r}; there are {', '.join(ITEM_BYTES)}")
    return math.prod(stream.shape) * item if stream.shape is not None else 0
