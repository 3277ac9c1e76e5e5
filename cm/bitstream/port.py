# SPDX-License-Identifier: Apache-2.0
"""The configuration port of a device, in software: what the simulated ICAP is made of.

Bytes arrive in pieces of any size; the port follows sync, packets, frames and CRC as they come and
keeps the error bits that a device's STAT register would show.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Flag, auto

from cm.bitstream.container import Source, read_source
from cm.bitstream.devices import REVISION_MASK, Device, Family
from cm.bitstream.far import FrameAddress, decode_far
from cm.bitstream.module import ModuleIdentity, identify_bytes
from cm.bitstream.packets import Register
from cm.native import bitstream as native


class PortError(Flag):
    """What went wrong since the last reset."""

    NONE = 0
    CRC = auto()  # CRC_ERROR of STAT
    IDCODE = auto()  # ID_ERROR of STAT
    PACKET = auto()  # words that are no packet; nothing more is taken until reset


@dataclass(frozen=True, slots=True)
class FrameWrite:
    """Frames that arrived: where, how many words (whole frames, if the bitstream is sound), whose."""

    address: FrameAddress
    words: int
    module: ModuleIdentity | None  # where the run begins with the mark of our assembler


@dataclass(frozen=True, slots=True)
class Progress:
    """What one `ConfigPort.feed` brought; `desynced`: a section ended with DESYNC in it."""

    writes: tuple[FrameWrite, ...] = ()
    desynced: bool = False


class ConfigPort:
    """A device's configuration port. Not thread-safe.

    `swapped` tells the byte order of what is fed: True for memory that a DMA-fed ICAP reads
    (``66 55 99 AA``), False for the order in a `.bit`. Frames that come after an error do not count.
    """

    def __init__(self, device: Device, swapped: bool = True) -> None:
        self.device = device
        self.swapped = swapped
        self._port = native.Port(capture=True)
        self.reset()

    def reset(self) -> None:
        """Forget everything, as after power-on."""
        self._port.reset(capture=True)
        self._rest = b""
        self.errors = PortError.NONE
        self.frames = 0  # frames written without an error before them
        self.sections = 0  # DESYNCs seen

    @property
    def family(self) -> Family:
        """The family of the device that the port belongs to."""
        return self.device.family

    @property
    def synced(self) -> bool:
        """Whether the port is between a sync word and DESYNC."""
        return self._port.phase != 0

    @property
    def complete(self) -> bool:
        """Whether a whole bitstream went through without error: synced at least once, and out of sync again."""
        return self.errors is PortError.NONE and self.sections > 0 and not self.synced

    def feed(self, data: Source) -> Progress:
        """Take the next bytes; bytes of a word that is not whole yet wait for the next call."""
        view = read_source(data)
        if self._rest:
            view = memoryview(self._rest + bytes(view))
        whole = len(view) - len(view) % 4
        self._rest = bytes(view[whole:])
        return self._take(view[:whole])

    def _take(self, words: memoryview) -> Progress:
        writes: list[FrameWrite] = []
        sections = self.sections
        done = 0
        while done < len(words) // 4:
            used, events = self._port.feed(words, self.swapped, done)
            done += used
            for _, kind, register, value, count, _, _ in events.tolist():
                self._note(kind, register, value, count, writes)
        return Progress(tuple(writes), self.sections > sections)

    def _note(self, kind: int, register: int, value: int, count: int, writes: list[FrameWrite]) -> None:
        if kind == native.FRAMES:
            self._frames(value, count, writes)
        elif kind == native.CRC and value != count:
            self.errors |= PortError.CRC
        elif kind == native.WRITE and register == Register.IDCODE:
            if (value ^ self.device.idcode) & REVISION_MASK:
                self.errors |= PortError.IDCODE
        elif kind == native.FAULT:
            self.errors |= PortError.PACKET
        elif kind == native.DESYNC:
            self.sections += 1

    def _frames(self, far: int, count: int, writes: list[FrameWrite]) -> None:
        if self.errors:
            return
        self.frames += count // self.family.frame_words
        address = decode_far(far, self.family)
        writes.append(FrameWrite(address, count, identify_bytes(self._port.head_bytes)))
