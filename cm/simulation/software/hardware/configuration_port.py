# SPDX-License-Identifier: Apache-2.0
"""The configuration port of the simulated board: what a device does with the packets that it gets (UG470, UG570).

Packets and CRC are those of ``csrc/bitstream.c``, which the manager reads bitstreams with beforehand, and which
``cm_config_port.v`` has in hardware. Here is what follows from them in a device, and the error bits of STAT; it does
not object to what no device would object to.
"""

from __future__ import annotations

import struct
from enum import Flag, auto

from cm.device.native import bitstream as native
from cm.formats.bitstream.idcodes import REVISION_MASK, Device
from cm.formats.bitstream.packets import RCFG, READ_FDRO, SYNC, TYPE2_READ, Command, Register
from cm.formats.bitstream.simulated_module import ModuleIdentity, identify_bytes
from cm.frozen import dataclass

_COUNT = 0x07FFFFFF  # of a type 2 packet's header


class PortError(Flag):
    """What went wrong since the last reset."""

    NONE = 0
    CRC = auto()  # CRC_ERROR of STAT
    IDCODE = auto()  # ID_ERROR of STAT
    PACKET = auto()  # words that are not a packet; nothing more is taken until reset


@dataclass(frozen=True, slots=True)
class Arrival:
    """Frames that arrived: from which FAR on, how many words, and of which module, if our assembler's mark is there."""

    far: int
    words: int
    module: ModuleIdentity | None


class ConfigPort:
    """A device's configuration port, fed with words as a DMA-fed ICAP reads them from memory (``66 55 99 AA``).

    Frames that come after an error do not count. Not thread-safe.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self._packets = native.PacketProcessor()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as after power-on."""
        self._packets.reset(capture=True)
        self._reads = False  # CMD is RCFG
        self.asked: tuple[int, int] | None = None  # a read of FDRO: FAR, and how many words
        self.started = False  # CMD was START: what was loaded begins anew
        self.errors = PortError.NONE
        self.sound: int | None = None  # words before the first error
        self.frames = 0  # frames written without an error before them
        self.sections = 0  # DESYNCs seen

    @property
    def synced(self) -> bool:
        """Whether the port is between a sync word and DESYNC."""
        return self._packets.phase != 0

    @property
    def complete(self) -> bool:
        """Whether a whole bitstream went through without error: synced at least once, and out of sync again."""
        return self.errors is PortError.NONE and self.sections > 0 and not self.synced

    def feed(self, words: bytes | memoryview) -> list[Arrival]:
        """The frames that the next words write."""
        arrived = []
        done, end = 0, len(words) // 4
        while done < end:
            before = self._packets.position - done  # words of earlier calls
            used, events = self._packets.feed(words, True, done)
            done += used
            for event in events:
                if event.kind == native.FRAMES and not self.errors:
                    self.frames += event.count // self.device.family.frame_words
                    arrived.append(Arrival(event.value, event.count, self._module()))
                elif event.kind == native.FAULT and self._reads and event.value == READ_FDRO:
                    done = self._ask(words, event.word - before + 1)
                else:
                    self._follow(event)
        return arrived

    def _module(self) -> ModuleIdentity | None:
        head = self._packets.head
        return identify_bytes(struct.pack(f">{len(head)}I", *head))

    def _ask(self, words: bytes | memoryview, at: int) -> int:
        """Take the second header of a read, which bitstreams do not have; returns where packets go on."""
        header = int.from_bytes(words[4 * at : 4 * at + 4], "little")
        if header & ~_COUNT != TYPE2_READ:
            self._fail(PortError.PACKET, at)
            return len(words) // 4
        self.asked = self._packets.far, header & _COUNT
        self._packets.reset(capture=True)
        self._packets.feed(SYNC.to_bytes(4, "little"), True)
        return at + 1

    def _follow(self, event: native.Event) -> None:
        if event.kind == native.CRC and event.value != event.count:
            self._fail(PortError.CRC, event.word)
        elif event.kind == native.FAULT:
            self._fail(PortError.PACKET, event.word)
        elif event.kind == native.DESYNC:
            self.sections += 1
        elif event.kind == native.WRITE and event.reg == Register.CMD:
            self._reads = event.value == RCFG
            self.started |= event.value == Command.START
        elif (
            event.kind == native.WRITE
            and event.reg == Register.IDCODE
            and (event.value ^ self.device.idcode) & REVISION_MASK
        ):
            self._fail(PortError.IDCODE, event.word)

    def _fail(self, error: PortError, word: int) -> None:
        self.errors |= error
        self.sound = word if self.sound is None else self.sound
