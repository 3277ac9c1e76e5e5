# SPDX-License-Identifier: Apache-2.0
"""The frames of the simulated device: what is in them, for reading back, and bits that radiation has turned over.

Loads only leave their words here; they are sorted into frames when somebody reads, or turns bits over.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Mapping

from cm.formats.bitstream.devices import Device, Family
from cm.formats.bitstream.geometry import decode_far, frame_order
from cm.simulation.software.hardware.configuration_port import ConfigPort, FrameWrite

_WAITING = 8  # loads that may wait to be sorted
_PIPELINE = {Family.SERIES7: 0, Family.ULTRASCALE_PLUS: 25}  # words ahead of what is read (UG570)


class Frames:
    """Frames by FAR, their words as they lie in memory for DMA; where the device's columns are not public, none."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._order = frame_order(device.name, device.family)
        self._size = 4 * device.family.frame_words
        self._frames: dict[int, bytes] = {}
        self._waiting: dict[tuple[tuple[int, int], ...], bytes] = {}
        self._random = random.Random(1)
        self.upset: dict[int, int] = {}  # frames that were hit since they were written: the bits, as a number

    def loaded(self, stream: memoryview, key: tuple[tuple[int, int], ...]) -> None:
        """A load has ended, well or not; one with the same `key` has written the same frames."""
        self._waiting.pop(key, None)
        self._waiting[key] = bytes(stream)
        if self.upset or len(self._waiting) > _WAITING:
            self._sort()

    def clear(self) -> None:
        """Nothing is configured, as after power-up."""
        self._waiting.clear()
        self._frames.clear()
        self.upset.clear()

    def only_mends(self, write: FrameWrite) -> bool:
        """Whether frames that arrive differ from those that are there in bits that were hit, and in no others."""
        there = self._sorted()
        for far, frame in self._placed(write, b""):
            before = there.get(far)
            if before is None or (_number(before) ^ _number(frame)) & ~self.upset.get(far, 0):
                return False
        return True

    def read(self, far: int, words: int) -> bytes:
        """What the port gives for a read of FDRO: words ahead, a frame of padding, then frames from `far` on."""
        there = self._sorted()
        count = max(0, (words - _PIPELINE[self.device.family]) // (self._size // 4) - 1)
        empty, begin = bytes(self._size), None if self._order is None else self._order.place.get(far)
        places = [] if begin is None or self._order is None else self._order.order[begin : begin + count]
        data = [empty if place is None else there.get(place, empty) for place in places]
        data += [empty] * (count - len(data))
        return b"".join([bytes(4 * words - count * self._size), *data])

    def held(self, columns: Iterable[tuple[int, int, int]]) -> list[int]:
        """The frames of some columns (block type, row, column) that were written, in order."""
        wanted, family = set(columns), self.device.family
        found = ((far, decode_far(far, family)) for far in sorted(self._sorted()))
        return [far for far, place in found if (place.block_type, place.row, place.column) in wanted]

    def hit(self, far: int, bit: int | None = None) -> int:
        """Turn a bit of a frame over, a random one by default; returns which: word times 32 and bit of the word."""
        bit = self._random.randrange(8 * self._size) if bit is None else bit
        frame = bytearray(self._sorted()[far])
        frame[bit // 8] ^= 1 << bit % 8
        self._frames[far] = bytes(frame)
        self.upset[far] = self.upset.get(far, 0) ^ 1 << bit
        if not self.upset[far]:
            del self.upset[far]
        return bit

    def pick(self, among: list[int]) -> int:
        """A random one."""
        return self._random.choice(among)

    def frame(self, far: int) -> bytes:
        """One that is held."""
        return self._sorted()[far]

    def _sorted(self) -> Mapping[int, bytes]:
        if self._waiting:
            self._sort()
        return self._frames

    def _sort(self) -> None:
        streams, self._waiting = list(self._waiting.values()), {}
        for stream in streams:
            held = b""
            port = ConfigPort(self.device, keeps=True)
            for write in port.feed(stream):
                for far, frame in self._placed(write, held):
                    self._frames[far] = frame
                    self.upset.pop(far, None)
                held = write.data[-self._size :] or held

    def _placed(self, write: FrameWrite, held: bytes) -> Iterator[tuple[int, bytes]]:
        """Where frames go. The last frame of a run stays in the port: it pushes out the one before."""
        if self._order is None or write.far not in self._order.place:
            return
        count = len(write.data) // self._size - 1
        for number, far in self._order.run(write.far):
            if write.again is not None:
                if number == write.again:
                    yield far, held
                    return
            elif number >= count:
                return
            else:
                yield far, write.data[number * self._size : (number + 1) * self._size]


def _number(frame: bytes) -> int:
    return int.from_bytes(frame, "little")
