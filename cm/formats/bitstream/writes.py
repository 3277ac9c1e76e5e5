# SPDX-License-Identifier: Apache-2.0
"""What a bitstream's packets do: the events of a whole stream, and the frame data in them."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from cm.device.native import bitstream as native
from cm.formats.bitstream.container import Image
from cm.frozen import dataclass

_TYPE1_COUNT = 0x7FF  # of a header; 0 where a type 2 header with the count follows


@dataclass(frozen=True, slots=True)
class FrameWrite:
    """Frame data that packets carry, big-endian, from frame address `far` on, which increments by itself.

    `repeated`: no data of its own, but the frame that is held in the port since the last one, at `far` and at the
    following addresses, that many (MFWR).
    """

    far: int
    data: bytes = b""
    repeated: int = 0


def packet_events(image: Image, port: native.PacketProcessor) -> Iterator[native.Event]:
    """Run the whole stream through a port, and give its events one by one."""
    done = 0
    while done < len(image.stream) // 4:
        used, events = port.feed(image.stream, image.swapped, done)
        done += used
        yield from events


def frame_writes(image: Image) -> Iterator[FrameWrite]:
    """The frame data of a good bitstream, in its order. Packets that go on from one FAR are one write."""
    words = native.swap(image.stream) if image.swapped else bytes(image.stream)
    run: FrameWrite | None = None
    for at, kind, _, far, count, before, repeated in packet_events(image, native.PacketProcessor()):
        if kind == native.FRAMES:
            (header,) = struct.unpack_from(">I", words, 4 * at)
            first = at + (1 if header & _TYPE1_COUNT else 2)
            data = words[4 * first : 4 * (first + count)]
            if run is not None and before:
                run = FrameWrite(far, run.data + data)
                continue
            if run is not None:
                yield run
            run = FrameWrite(far, data)
        elif kind == native.MULTI:
            if run is not None:
                yield run
                run = None
            yield FrameWrite(far, repeated=repeated)
    if run is not None:
        yield run
