# SPDX-License-Identifier: Apache-2.0
"""The rules of a sound configuration stream, applied to the events of a port.

They are strict enough that no single flipped bit between the first sync word and the last DESYNC of
a stream with CRCs gets through: what a CRC does not cover (before RCRC, after the last CRC, NOPs,
padding, headers) may only be what real tools write there. `docs/decisions/bitstreams-are-read.md` gives the argument.
"""

from __future__ import annotations

from cm.device.native import bitstream as native
from cm.formats.bitstream.errors import BadContainer, BadPacket, BitstreamError, CrcMismatch, CrcMissing, Truncated
from cm.formats.bitstream.inspection_report import CrcResult, Refusal
from cm.formats.bitstream.packets import Command, Register

# Register writes that may stand where no CRC covers them.
_NEUTRAL = {
    (Register.CMD, Command.NULL),
    (Register.CMD, Command.URAM),
    (Register.CMD, Command.BSPI_READ),
    (Register.BSPI, 0x00B),  # how a flash is read, unused when we load it: one bit wide,
    (Register.BSPI, 0x26B),  # or four; as Vivado writes it where SPI_BUSWIDTH is set
    (Register.TIMER, 0),
    (Register.WBSTAR, 0),
}
_COMMANDS = {int(command) for command in Command}
_FAULTS = {
    1: "is not a packet header",
    2: "is neither a write nor the exact NOP 20000000",
    3: "addresses a register that no bitstream writes",
    4: "has a word count that its register cannot have",
    5: "breaks the pair of a type 1 and a type 2 packet",
    6: "is the CRC of the words before it, written to another register",
}


class Rules:
    """Follows a stream's events (all but FRAMES and MULTI) and collects what is wrong with it."""

    def __init__(self, encrypted: bool) -> None:
        """`encrypted`: the container says so already."""
        self.problems: list[Refusal] = []
        self.idcodes: list[int] = []
        self.syncs: list[int] = []
        self.desyncs: list[int] = []
        self.registers: set[int] = set()
        self.encrypted = encrypted
        self.crc = CrcResult.ABSENT  # over all CRCs of the stream
        self._uncovered: list[tuple[int, int]] = []  # writes since the last CRC or RCRC
        self._gaps: list[Refusal] = []  # refusals only if the stream has CRCs at all
        self._reset = False  # of RCRC and CRC the last one was RCRC
        self._starts: set[int] = set()  # numbers of the sections with START in them

    def refuse(self, error: type[BitstreamError], message: str) -> None:
        """Note a problem; people get to read the first of each code."""
        self.problems.append(Refusal.of(error, message))

    def take(self, event: native.Event) -> None:
        """Apply the rules to the next event."""
        if event.kind == native.SYNC:
            self.syncs.append(event.word)
            self._uncovered.clear()
            self._reset = False
        elif event.kind == native.WRITE:
            self._write(event)
        elif event.kind == native.CRC:
            self._crc(event)
        elif event.kind == native.DESYNC:
            self._boundary(event, "DESYNC")
            self.desyncs.append(event.word + 2)
        elif event.kind == native.OPAQUE:
            self.encrypted = True
        elif not self.encrypted:
            self._foreign(event)

    def finish(self, phase: int, words: int) -> None:
        """Apply the rules for the end of the stream; `phase` as `cm.device.native.bitstream.PacketProcessor.phase`."""
        if self.encrypted:
            return
        if phase == 1:
            self.refuse(Truncated, f"the stream ends inside a packet, after {words} words")
        elif phase == 2:
            self.refuse(Truncated, f"the stream ends without DESYNC, after {words} words")
        if self.crc is not CrcResult.ABSENT:
            self.problems.extend(self._gaps)

    def _foreign(self, event: native.Event) -> None:
        if event.kind == native.FAULT:
            self.refuse(BadPacket, f"word {event.word}: {event.value:08X} {_FAULTS[event.reg]}")
        elif event.kind == native.STRAY:
            self.refuse(BadPacket, f"word {event.word}: {event.value:08X} is outside of sync and is not padding")

    def _write(self, event: native.Event) -> None:
        self.registers.add(event.reg)
        if event.reg == Register.IDCODE:
            self.idcodes.append(event.value)
        elif event.reg == Register.CBC:
            self.encrypted = True
        elif event.reg == Register.CMD:
            self._command(event)
            if event.value == Command.RCRC:
                return
        self._uncovered.append((event.reg, event.value))

    def _command(self, event: native.Event) -> None:
        if event.value not in _COMMANDS:
            self.refuse(BadPacket, f"word {event.word}: CMD {event.value:08X} is not allowed in a bitstream")
        elif event.value == Command.START:
            self._start(event)
        elif event.value == Command.RCRC:
            if self._reset and event.count == 0:
                self._gaps.append(Refusal.of(BadPacket, f"word {event.word}: RCRC follows RCRC"))
            self._boundary(event, "RCRC")
            self._reset = True

    def _start(self, event: native.Event) -> None:
        """No tool starts a device twice in one bitstream, however many sections it has."""
        section = len(self.syncs)
        if self._starts - {section}:
            self.refuse(BadContainer, f"word {event.word}: a second image follows the first: give one at a time")
        self._starts.add(section)

    def _boundary(self, event: native.Event, name: str) -> None:
        """RCRC and DESYNC: what was written since the last CRC or RCRC stays unchecked."""
        odd = [pair for pair in self._uncovered if pair not in _NEUTRAL]
        if event.extra or odd or len(set(self._uncovered)) < len(self._uncovered):
            what = f"{event.count} register writes before {name} are covered by no CRC"
            self._gaps.append(Refusal.of(CrcMissing, f"word {event.word}: {what}"))
        self._uncovered.clear()

    def _crc(self, event: native.Event) -> None:
        self._reset = False
        self._uncovered.clear()
        if event.value != event.count:
            self.crc = CrcResult.WRONG
            message = f"word {event.word}: CRC {event.value:08X} in the stream, {event.count:08X} computed"
            self.refuse(CrcMismatch, message)
            return
        if self.crc is CrcResult.ABSENT:
            self.crc = CrcResult.OK
        if event.extra == 0:
            self._gaps.append(Refusal.of(BadPacket, f"word {event.word}: a CRC that covers nothing"))
