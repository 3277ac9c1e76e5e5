# SPDX-License-Identifier: Apache-2.0
"""Words, registers and commands of the configuration logic, and what a stream of them does.

UG470 table 5-23, UG570 table 9-19.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from typing import Final

from cm.device.native import bitstream as native
from cm.formats.bitstream.container import Image
from cm.formats.bitstream.idcodes import Family
from cm.frozen import dataclass

SYNC: Final = 0xAA995566
NOP: Final = 0x20000000
DUMMY: Final = 0xFFFFFFFF
BUS_WIDTH_SYNC: Final = 0x000000BB
BUS_WIDTH_DETECT: Final = 0x11220044
TYPE1_LIMIT: Final = 0x7FF  # words a type 1 packet can carry
RCFG: Final = 4  # a value of CMD that no bitstream has
READ_FDRO: Final = 0x28006000  # header of a type 1 read of FDRO (register 3) of no words; the count follows as type 2
TYPE2_READ: Final = 0x48000000
PIPELINE: Final = {Family.SERIES7: 0, Family.ULTRASCALE_PLUS: 25}  # words ahead of frames that are read (UG570)


class Register(IntEnum):
    """Configuration registers that a bitstream writes."""

    CRC = 0
    FAR = 1
    FDRI = 2
    CMD = 4
    CTL0 = 5
    MASK = 6
    LOUT = 8
    COR0 = 9
    MFWR = 10
    CBC = 11
    IDCODE = 12
    AXSS = 13
    COR1 = 14
    WBSTAR = 16
    TIMER = 17
    RBCRC_SW = 19
    CTL1 = 24
    DWC = 26
    BSPI = 31


class Command(IntEnum):
    """Values of CMD that stand in bitstreams; any other is refused (IPROG would restart the device)."""

    NULL = 0
    WCFG = 1
    MFW = 2
    DGHIGH = 3
    START = 5
    URAM = 6
    RCRC = 7
    AGHIGH = 8
    SWITCH = 9
    GRESTORE = 10
    SHUTDOWN = 11
    DESYNC = 13
    BSPI_READ = 18
    FALL_EDGE = 19


def type1(register: int, count: int) -> int:
    """Return the header word of a type 1 write of ``count`` words."""
    return 0x30000000 | register << 13 | count


def type2(count: int) -> int:
    """Return the header word of a type 2 write, which follows a type 1 of no words."""
    return 0x50000000 | count


def word_of(words: bytes | bytearray, at: int) -> int:
    """Return one of big-endian words."""
    return int.from_bytes(words[4 * at : 4 * at + 4], "big")


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
            first = at + (1 if word_of(words, at) & TYPE1_LIMIT else 2)  # 0: a type 2 header with the count follows
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
