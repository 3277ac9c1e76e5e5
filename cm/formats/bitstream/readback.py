# SPDX-License-Identifier: Apache-2.0
"""Frames read back from a device: the words that ask for them, and the comparison with what was loaded.

The sequence is that of UG470 and UG570, "Configuration Memory Read Procedure", without the shutdown, which would stop
the design, as AMD's own driver does it through the ICAP (embeddedsw, hwicap, `XHwIcap_DeviceReadFrame`).
docs/readback.md has it step by step. Words are big-endian, as in a `.bit`, but in a `Slice` as they lie in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from cm.device.native import bitstream as native
from cm.formats.bitstream.assemble import StreamWriter
from cm.formats.bitstream.container import Image
from cm.formats.bitstream.geometry import FrameAddress, decode_far, frame_order
from cm.formats.bitstream.idcodes import Device, Family
from cm.formats.bitstream.mask import Mask, Masks
from cm.formats.bitstream.memory import frames_of
from cm.formats.bitstream.packets import (
    BUS_WIDTH_DETECT,
    BUS_WIDTH_SYNC,
    DUMMY,
    NOP,
    PIPELINE,
    RCFG,
    READ_FDRO,
    SYNC,
    TYPE2_READ,
    Command,
    Register,
)
from cm.formats.bitstream.simulated_module import identify_bytes
from cm.formats.xray.frames import set_bits
from cm.frozen import dataclass

_FLUSH = {Family.SERIES7: 34, Family.ULTRASCALE_PLUS: 66}  # NOPs that push the request through the packet buffer


def request_words(family: Family, far: int, frames: int) -> bytes:
    """What is written before `frames` frames can be read from the address `far` on."""
    writer = StreamWriter()
    writer.raw(DUMMY, BUS_WIDTH_SYNC, BUS_WIDTH_DETECT, DUMMY, SYNC, NOP)
    writer.command(Command.RCRC, nops=6)
    writer.write(Register.CMD, RCFG)
    writer.raw(NOP)
    writer.write(Register.FAR, far)
    writer.raw(READ_FDRO, TYPE2_READ | reply_words(family, frames), *[NOP] * _FLUSH[family])
    return bytes(writer.words)


def reply_words(family: Family, frames: int) -> int:
    """How many words are read then: a frame of padding comes first, on UltraScale+ behind the pipeline's words."""
    return PIPELINE[family] + (frames + 1) * family.frame_words


def closing_words() -> bytes:
    """What is written after the last word was read. No START: nothing was stopped."""
    writer = StreamWriter()
    writer.raw(NOP)
    writer.command(Command.RCRC)
    writer.command(Command.DESYNC, nops=16)
    return bytes(writer.words)


def repair_words(device: Device, runs: Iterable[tuple[int, Sequence[bytes]]]) -> bytes:
    """A bitstream that writes frames (big-endian) from an address on, each run of them, and does nothing else.

    No GRESTORE and no START, which would set flip-flops to their initial values: the design goes on running.
    """
    writer = StreamWriter()
    writer.raw(*[DUMMY] * 8, BUS_WIDTH_SYNC, BUS_WIDTH_DETECT, DUMMY, DUMMY, SYNC, NOP)
    writer.command(Command.RCRC, nops=2)
    writer.write(Register.IDCODE, device.idcode)
    for far, frames in runs:
        writer.write(Register.FAR, far)
        writer.command(Command.WCFG)
        writer.bulk(Register.FDRI, b"".join([*frames, bytes(4 * device.family.frame_words)]))
    writer.check()
    writer.raw(NOP, NOP)
    writer.command(Command.DESYNC, nops=16)
    return bytes(writer.words)


@dataclass(frozen=True, slots=True)
class WrongFrame:
    """A frame that is not as it was loaded: `bits` are those that differ, 32 times the word and the bit in it."""

    far: int
    address: FrameAddress
    bits: tuple[int, ...]
    volatile: bool  # the fabric itself changes other bits of it, so it cannot simply be written again


@dataclass(frozen=True, slots=True)
class Slice:
    """Frames that follow each other in the device, as they are read in one go: words as for DMA (``dma``)."""

    request: bytes
    reply_length: int  # bytes
    closing: bytes
    judge: Callable[[bytes | memoryview], tuple[WrongFrame, ...]]  # of the reply


class LoadedFrames:
    """The frames of a loaded bitstream, against which what is read back is compared.

    `unjudged` are frames that cannot be, with `why`; they are not read.
    """

    def __init__(self, device: Device, image: Image, mask: Mask) -> None:
        self._device, self._family = device, device.family
        self._cut: dict[int, tuple[Slice, ...]] = {}
        order = frame_order(device.name, device.family)
        self._place = order.place if order is not None else {}
        loaded = frames_of(image, order) if order is not None else {}
        masked: Masks = {}
        if order is None:
            self.why = f"the frames of {device.name}'s columns are not public"
        elif mask.source != "msk" and self._made_up(loaded):
            self.why = "no circuit is in these frames: they were assembled for the simulated board"
        else:
            self.why, masked = mask.why, mask.of(loaded)
        left = {far for far, ignored in masked.items() if ignored is None}
        self._frames = {far: frame for far, frame in loaded.items() if far not in left}
        self._ignored = {far: ignored for far, ignored in masked.items() if ignored}
        self.unjudged = tuple(decode_far(far, self._family) for far in sorted(left))

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame."""
        return 4 * self._family.frame_words

    @property
    def judged(self) -> int:
        """How many frames are compared."""
        return len(self._frames)

    def slices(self, most: int) -> tuple[Slice, ...]:
        """All frames, `most` at a time."""
        if most not in self._cut:
            self._cut[most] = tuple(self._sliced(most))
        return self._cut[most]

    def _sliced(self, most: int) -> Iterator[Slice]:
        run: list[int] = []
        for far in sorted(self._frames):
            if run and (len(run) == most or self._place[far] != self._place[run[-1]] + 1):
                yield self._slice(tuple(run))
                run = []
            run.append(far)
        if run:
            yield self._slice(tuple(run))

    def repair(self, wrong: Iterable[WrongFrame]) -> bytes | None:
        """A bitstream as it is in memory for DMA that writes frames anew; None where the region has to be loaded.

        A frame with bits that the fabric itself changes would lose them: what a look-up table holds as memory.
        """
        frames = list(wrong)
        if any(frame.volatile for frame in frames):
            return None
        runs = [(frame.far, [native.swap(self._in_memory(frame.far))]) for frame in frames]
        return native.swap(repair_words(self._device, runs))

    def _slice(self, fars: tuple[int, ...]) -> Slice:
        family = self._family
        expected = b"".join(map(self._in_memory, fars))
        request = native.swap(request_words(family, fars[0], len(fars)))
        length = 4 * reply_words(family, len(fars))

        def judge(reply: bytes | memoryview) -> tuple[WrongFrame, ...]:
            there = bytes(reply[length - len(expected) : length])
            return () if there == expected else tuple(self._differences(fars, there))

        return Slice(request, length, native.swap(closing_words()), judge)

    def _differences(self, fars: tuple[int, ...], there: bytes) -> Iterator[WrongFrame]:
        for number, far in enumerate(fars):
            frame = there[number * self.frame_bytes : (number + 1) * self.frame_bytes]
            ignored = self._ignored.get(far, 0)
            wrong = (int.from_bytes(frame, "little") ^ self._frames[far]) & ~ignored
            if wrong:
                yield WrongFrame(far, decode_far(far, self._family), tuple(set_bits(wrong)), bool(ignored))

    def _in_memory(self, far: int) -> bytes:
        """A frame as it lies in memory for DMA."""
        return self._frames[far].to_bytes(self.frame_bytes, "little")

    def _made_up(self, frames: Mapping[int, int]) -> bool:
        """Whether they are of our own assembler, and do not configure anything."""
        first = next(iter(frames.values()), 0).to_bytes(self.frame_bytes, "little")
        return identify_bytes(native.swap(first)) is not None
