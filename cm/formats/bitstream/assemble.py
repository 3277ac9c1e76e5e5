# SPDX-License-Identifier: Apache-2.0
"""Our own assembler: real `.bit` files with any frame data, for the simulated board and for tests.

What it writes has the form that Vivado's files have (header fields, bus-width pattern, sync, RCRC,
IDCODE, FAR, FDRI, CRC, START, CRC, DESYNC), and the same input gives the same bytes. The frame data
is the caller's: such a file configures a simulated port, and would do harm in a real device.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from itertools import pairwise

from cm.device.native import bitstream as native
from cm.formats.bitstream.container import BitHeader, pack_bit
from cm.formats.bitstream.geometry import FrameAddress, encode_far
from cm.formats.bitstream.idcodes import Device, Family, known_device
from cm.formats.bitstream.packets import (
    BUS_WIDTH_DETECT,
    BUS_WIDTH_SYNC,
    DUMMY,
    NOP,
    SYNC,
    TYPE1_LIMIT,
    Command,
    Register,
    type1,
    type2,
)
from cm.frozen import dataclass

_MFWR_WORDS = {Family.SERIES7: 4, Family.ULTRASCALE_PLUS: 14}  # as Vivado writes; their values mean nothing
_UNPRINTABLE = re.compile(r"[^!-:<-~]")  # in a header: all but visible ASCII, and the separator


@dataclass(frozen=True, slots=True)
class FrameRun:
    """Whole frames (big-endian words) written from `address` on, which increments by itself."""

    address: FrameAddress
    data: bytes


@dataclass(frozen=True, slots=True)
class SharedFrame:
    """One frame written to every one of `addresses` by MFWR, as compressed bitstreams do."""

    data: bytes
    addresses: tuple[FrameAddress, ...]


class StreamWriter:
    """Collects configuration words, big-endian, and keeps the CRC of what a device would see."""

    def __init__(self) -> None:
        self.words = bytearray()
        self.crc = 0

    def raw(self, *words: int) -> None:
        """Append words as they are: padding, NOPs, sync."""
        self.words += struct.pack(f">{len(words)}I", *words)

    def write(self, register: int, value: int) -> None:
        """Append a write of one register."""
        self.raw(type1(register, 1), value)
        self.crc = native.crc(self.crc, register, struct.pack(">I", value))

    def command(self, command: Command, nops: int = 1) -> None:
        """Append a write of CMD and NOPs after it."""
        self.write(Register.CMD, command)
        if command is Command.RCRC:
            self.crc = 0
        self.raw(*[NOP] * nops)

    def bulk(self, register: int, data: bytes) -> None:
        """Append a write of many words, by a type 2 packet where type 1 cannot hold it."""
        count = len(data) // 4
        if count > TYPE1_LIMIT:
            self.raw(type1(register, 0), type2(count))
        else:
            self.raw(type1(register, count))
        self.words += data
        self.crc = native.crc(self.crc, register, data)

    def check(self) -> None:
        """Append the CRC of everything since the last one."""
        self.raw(type1(Register.CRC, 1), self.crc)
        self.crc = 0


def _write_frames(writer: StreamWriter, device: Device, run: FrameRun | SharedFrame) -> None:
    if not run.data or len(run.data) % (4 * device.family.frame_words):
        raise ValueError(f"{len(run.data)} bytes are not whole frames of {4 * device.family.frame_words} bytes")
    first = run.address if isinstance(run, FrameRun) else run.addresses[0]
    writer.write(Register.FAR, encode_far(first, device.family))
    writer.command(Command.WCFG)
    writer.bulk(Register.FDRI, run.data)
    if isinstance(run, SharedFrame):
        writer.command(Command.MFW, nops=12)
        for address in run.addresses:
            writer.write(Register.FAR, encode_far(address, device.family))
            writer.raw(NOP)
            writer.bulk(Register.MFWR, bytes(4 * _MFWR_WORDS[device.family]))
            writer.raw(NOP, NOP)


def _begin_section(writer: StreamWriter, device: Device, partial: bool) -> None:
    writer.raw(*[DUMMY] * 8, BUS_WIDTH_SYNC, BUS_WIDTH_DETECT, DUMMY, DUMMY, SYNC, NOP)
    if not partial:
        writer.write(Register.TIMER, 0)
        writer.write(Register.WBSTAR, 0)
        writer.command(Command.NULL)
    writer.command(Command.RCRC, nops=2)
    if not partial:
        writer.write(Register.COR0, 0x02003FE5)
    writer.write(Register.IDCODE, device.idcode)
    writer.write(Register.MASK, 0x00000500)
    writer.write(Register.CTL0, 0x00000400)


def _end_section(writer: StreamWriter, crc: bool, last: bool) -> None:
    if crc:
        writer.check()
    writer.raw(NOP, NOP)
    writer.command(Command.GRESTORE, nops=2)
    if last:
        writer.command(Command.START)
    if crc:
        writer.check()
    writer.raw(NOP, NOP)
    writer.command(Command.DESYNC, nops=16)


def assemble_stream(
    device: str | Device,
    sections: Sequence[Sequence[FrameRun | SharedFrame]],
    *,
    partial: bool = True,
    crc: bool = True,
) -> bytes:
    """Return the big-endian configuration words of one sync…DESYNC section for each of `sections`.

    Raises `UnknownDevice`, or ValueError for frame data that is not a whole number of frames.
    """
    known = known_device(device)
    writer = StreamWriter()
    for number, runs in enumerate(sections, 1):
        _begin_section(writer, known, partial)
        for run in runs:
            _write_frames(writer, known, run)
        _end_section(writer, crc, number == len(sections))
    return bytes(writer.words)


def assemble(
    device: str | Device,
    runs: Sequence[FrameRun | SharedFrame],
    *,
    design: str = "cm_assembled",
    part: str | None = None,
    partial: bool = True,
    crc: bool = True,
    sections: int = 1,
    date: str = "2024/01/01",
    time: str = "00:00:00",
    version: str = "cm",
    user_id: int = 0xFFFF_FFFF,
) -> bytes:
    """Return a whole `.bit` file that writes `runs`, spread in order over `sections` sections.

    `part` is the full part name of the header (the device's name if None); `date` and `time` are
    given, not taken from a clock, so that equal input gives equal bytes. `user_id`: all ones means none.
    """
    known = known_device(device)
    if not 1 <= sections <= len(runs):
        raise ValueError(f"{len(runs)} runs cannot fill {sections} sections")
    ends = [len(runs) * number // sections for number in range(sections + 1)]
    groups = [runs[begin:end] for begin, end in pairwise(ends)]
    fields = {"UserID": f"0X{user_id:08X}", **({"PARTIAL": "TRUE"} if partial else {}), "Version": version}
    header = BitHeader(
        design=_UNPRINTABLE.sub("_", design),
        fields=tuple(fields.items()),
        part=part or known.name,
        date=date,
        time=time,
    )
    return pack_bit(header, assemble_stream(known, groups, partial=partial, crc=crc))
