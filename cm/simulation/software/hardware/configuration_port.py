# SPDX-License-Identifier: Apache-2.0
"""The configuration port of the simulated board: its own small reader of packets (UG470 chapter 5, UG570 chapter 9).

It shares no code with `cm.formats.bitstream`, which says beforehand whether a bitstream is good: a mistake in
one of them shows where they differ. It does what a device does: follows sync, packets, frames and CRC as
words come, and keeps the error bits of STAT; it does not object to what no device would object to.
"""

from __future__ import annotations

from array import array
from enum import Enum, Flag, auto

from cm.device.native import sim_crc
from cm.formats.bitstream.devices import Device
from cm.formats.bitstream.geometry import FrameAddress
from cm.formats.bitstream.module import ModuleIdentity, identify_bytes
from cm.frozen import dataclass

_SYNC, _NOP = b"\x66\x55\x99\xaa", 0x20000000
_CRC, _FAR, _FDRI, _FDRO, _CMD, _LOUT, _MFWR, _CBC, _IDCODE, _DWC = 0, 1, 2, 3, 4, 8, 10, 11, 12, 26
_RCFG, _START, _RCRC, _DESYNC = 4, 5, 7, 13
_REVISION = 0x0FFFFFFF  # the rest of an IDCODE is the silicon's revision
_REGISTERS = {0, 1, 2, 4, 5, 6, 8, 9, 10, 11, 12, 13, 14, 16, 17, 19, 24, 26, 31}  # that are written
_BULK = {_FDRI, _MFWR, _CBC}
# Words of a frame, and where the fields of FAR begin (type, row with its half, column, minor).
_SHAPES = {"7series": (101, (23, 17, 7, 0)), "ultrascale+": (93, (24, 18, 8, 0))}


class PortError(Flag):
    """What went wrong since the last reset."""

    NONE = 0
    CRC = auto()  # CRC_ERROR of STAT
    IDCODE = auto()  # ID_ERROR of STAT
    PACKET = auto()  # words that are not a packet; nothing more is taken until reset


@dataclass(frozen=True, slots=True)
class FrameWrite:
    """Frames that arrived: where, how many words, and of which module, if they begin with our assembler's mark.

    Where the port keeps them, also `data`, as it was fed, and FAR. `again` numbers writes by MFWR since FAR was
    written: of the frame that was written last, which is not said to have arrived otherwise.
    """

    address: FrameAddress
    words: int
    module: ModuleIdentity | None
    far: int = 0
    data: bytes = b""
    again: int | None = None


class _State(Enum):
    UNSYNCED = auto()
    HEADER = auto()
    TYPE2 = auto()  # a type 1 of no words came: the count follows
    DATA = auto()
    CIPHER = auto()  # encrypted words: taken, not understood
    DEAD = auto()


class ConfigPort:
    """A device's configuration port. Not thread-safe.

    `swapped` tells the byte order of what is fed: True for memory that a DMA-fed ICAP reads
    (``66 55 99 AA``), False for the order in a `.bit`. Frames that come after an error do not count.
    """

    def __init__(self, device: Device, swapped: bool = True, keeps: bool = False) -> None:
        """`keeps`: writes come with their data."""
        self.device = device
        self.keeps = keeps
        self._swapped = swapped
        self._frame_words, self._fields = _SHAPES[device.family.label]
        self.reset()

    def reset(self) -> None:
        """Forget everything, as after power-on."""
        self._rest = b""
        self._state = _State.UNSYNCED
        self._register = self._left = self._crc = self._far = self._count = 0
        self._head = b""
        self._kept: list[bytes] = []
        self._again = 0
        self._writes: list[FrameWrite] = []
        self._reads = False  # CMD is RCFG
        self.asked: tuple[int, int] | None = None  # a read of FDRO: FAR, and how many words
        self.started = False  # CMD was START: what was loaded begins anew
        self.errors = PortError.NONE
        self.frames = 0  # frames written without an error before them
        self.sections = 0  # DESYNCs seen

    @property
    def synced(self) -> bool:
        """Whether the port is between a sync word and DESYNC."""
        return self._state is not _State.UNSYNCED

    @property
    def complete(self) -> bool:
        """Whether a whole bitstream went through without error: synced at least once, and out of sync again."""
        return self.errors is PortError.NONE and self.sections > 0 and not self.synced

    def feed(self, data: bytes | bytearray | memoryview) -> tuple[FrameWrite, ...]:
        """The frames that the next bytes write. Bytes of a word that is not whole yet wait for the next call."""
        raw = self._rest + data
        whole = len(raw) - len(raw) % 4
        self._rest = bytes(raw[whole:])
        words = memoryview(raw)[:whole].cast("I")
        if not self._swapped:
            words = memoryview(_swapped(words)).cast("I")
        self._writes = []
        at = 0
        while at < len(words) and self._state is not _State.DEAD:
            at += self._take(words, at)
        return tuple(self._writes)

    def _take(self, words: memoryview, at: int) -> int:
        """Take one word at least, from `at` on; returns how many."""
        if self._state is _State.UNSYNCED:
            return self._look_for_sync(words[at:])
        if self._state is _State.DATA or self._state is _State.CIPHER:
            return self._data(words[at : at + self._left])
        word: int = words[at]
        if self._state is _State.TYPE2 and self._register == _FDRO:
            self._ask(word)
        elif self._state is _State.TYPE2:
            self._begin(word & 0x07FFFFFF, word >> 27 == 0b01010 and word & 0x07FFFFFF != 0)
        elif word == 0:
            self._crc = sim_crc.word(self._crc, _FDRI, 0)  # padding of a debug bitstream
        elif word != _NOP:
            self._header(word)
        return 1

    def _look_for_sync(self, words: memoryview) -> int:
        data = words.tobytes()
        at = data.find(_SYNC)
        while at % 4 and at > 0:
            at = data.find(_SYNC, at + 1)
        if at < 0:
            return len(words)
        self._state = _State.HEADER
        return at // 4 + 1

    def _header(self, word: int) -> None:
        register, count = word >> 13 & 0x1F, word & 0x7FF
        if word >> 27 == 0b00101 and register == _FDRO and self._reads and not count:
            self._register, self._state = register, _State.TYPE2
            return
        self._register = register
        sound = word >> 27 == 0b00110 and not word & 0x07FC1800 and register in _REGISTERS
        if sound and count == 0 and register in _BULK:
            self._state = _State.TYPE2
        else:
            self._begin(count, sound and (count == 1 or register in _BULK))

    def _ask(self, word: int) -> None:
        if word >> 27 != 0b01001:
            self._begin(0, sound=False)
            return
        self.asked = self._far, word & 0x07FFFFFF
        self._state = _State.HEADER

    def _begin(self, count: int, sound: bool) -> None:
        if not sound:
            self.errors |= PortError.PACKET
            self._state = _State.DEAD
            return
        self._state, self._left, self._count, self._head = _State.DATA, count, count, b""

    def _data(self, words: memoryview) -> int:
        self._left -= len(words)
        if self._state is _State.CIPHER:
            self._state = _State.HEADER if self._left == 0 else _State.CIPHER
        elif self._register in _BULK:
            self._bulk(words)
        else:
            self._state = _State.HEADER
            self._write(words[0])
        return len(words)

    def _bulk(self, words: memoryview) -> None:
        self._crc = sim_crc.words(self._crc, self._register, words)
        missing = 4 * self._frame_words - len(self._head)
        if missing > 0:
            self._head += _swapped(words[: -(-missing // 4)])
        if self.keeps and self._register == _FDRI:
            self._kept.append(words.tobytes())
        if self._left == 0:
            self._state = _State.HEADER
            if self._register == _FDRI:
                self._frames()
            elif self._register == _MFWR and self.keeps and not self.errors:
                self._writes.append(FrameWrite(self._address(), 0, None, self._far, again=self._again))
                self._again += 1

    def _frames(self) -> None:
        data, self._kept = b"".join(self._kept), []
        if self.errors:
            return
        self.frames += self._count // self._frame_words
        identity = identify_bytes(self._head)
        self._writes.append(FrameWrite(self._address(), self._count, identity, self._far, data))

    def _address(self) -> FrameAddress:
        """Each field of FAR ends where the one above it begins; the block type has three bits."""
        ends = self._fields[0] + 3, *self._fields[:-1]
        return FrameAddress(*(self._far % (1 << end) >> begin for begin, end in zip(self._fields, ends, strict=True)))

    def _write(self, value: int) -> None:
        if self._register == _CRC:
            if value != self._crc:
                self.errors |= PortError.CRC
            self._crc = 0
            return
        if self._register == _LOUT:
            return
        self._crc = sim_crc.word(self._crc, self._register, value)
        if self._register == _FAR:
            self._far, self._again = value, 0
        elif self._register == _CMD:
            self._command(value)
        elif self._register == _IDCODE and (value ^ self.device.idcode) & _REVISION:
            self.errors |= PortError.IDCODE
        elif self._register == _DWC and value:
            self._state, self._left = _State.CIPHER, value

    def _command(self, value: int) -> None:
        self._reads = value == _RCFG
        self.started |= value == _START
        if value == _RCRC:
            self._crc = 0
        elif value == _DESYNC:
            self._state = _State.UNSYNCED
            self.sections += 1


def _swapped(words: memoryview) -> bytes:
    """The bytes of words, the highest first."""
    turned = array("I", words)
    turned.byteswap()
    return turned.tobytes()
