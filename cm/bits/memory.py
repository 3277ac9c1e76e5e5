# SPDX-License-Identifier: Apache-2.0
"""The configuration memory of a 7-series device: what loaded bitstreams leave in its frames (UG470 chapter 5)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from struct import unpack

from cm.bits.errors import BitsError
from cm.bitstream.devices import Device, Family
from cm.bitstream.far import FrameAddress, encode_far
from cm.bitstream.geometry import Row, geometry_of
from cm.xray.frames import WORDS

_SYNC, _DESYNC = 0xAA995566, 13
_FAR, _FDRI, _CMD, _MFWR = 1, 2, 4, 10
_PADS = 2  # frames behind each row that go nowhere


class FrameMemory:
    """Frames by their address (FAR), as `cm.xray` has them."""

    def __init__(self, device: Device) -> None:
        geometry = geometry_of(device.name)
        if device.family is not Family.SERIES7 or geometry is None:
            raise BitsError(f"{device.name}: the frames of its columns are not known, so its bits cannot be run")
        self.frames: dict[int, int] = {}
        self._family = device.family
        self._order = list(_addresses(geometry.rows, device.family))
        self._place = {address: number for number, address in enumerate(self._order) if address is not None}

    def load(self, stream: bytes) -> set[int]:
        """Take a bitstream as it is in memory for DMA (``66 55 99 AA``); returns the addresses of the frames it wrote.

        It is expected to be good: what the simulated port refuses does not come here.
        """
        words = unpack(f"<{len(stream) // 4}I", stream[: len(stream) // 4 * 4])
        written: set[int] = set()
        far, last = 0, 0
        for register, data in _packets(words):
            if register == _FAR:
                far = data[0]
            elif register == _FDRI:
                for address, frame in self._run(far, data):
                    self.frames[address] = last = frame
                    written.add(address)
            elif register == _MFWR:  # the frame that was written last, again
                self.frames[far] = last
                written.add(far)
        return written

    def _run(self, far: int, data: Sequence[int]) -> Iterator[tuple[int, int]]:
        """Frames one after the other from an address on; the last one only pushes the one before it in."""
        if far not in self._place:
            raise BitsError(f"frame address 0x{far:08x} is none of this device")
        begin = self._place[far]
        for number in range(len(data) // WORDS - 1):
            address = self._order[begin + number] if begin + number < len(self._order) else None
            if address is not None:
                frame = data[WORDS * number : WORDS * (number + 1)]
                yield address, sum(word << 32 * index for index, word in enumerate(frame) if word)


def _addresses(rows: Mapping[tuple[int, int], Row], family: Family) -> Iterator[int | None]:
    """All frames in the order in which the device counts them; None for those behind a row."""
    for block_type, row in sorted(rows):
        found = rows[block_type, row]
        for column in range(found.columns):
            for minor in range(found.frames(column)):
                yield encode_far(FrameAddress(block_type, row, column, minor), family)
        yield from [None] * _PADS


def _packets(words: Sequence[int]) -> Iterator[tuple[int, Sequence[int]]]:
    """Register and data of each write between sync and desync."""
    at, register, synced = 0, 0, False
    while at < len(words):
        word = words[at]
        at += 1
        if not synced:
            synced = word == _SYNC
            continue
        kind = word >> 29
        if kind == 1:
            register = word >> 13 & 0x1F
            count = word & 0x7FF if word >> 27 & 3 == 2 else 0
        elif kind == 2:
            count = word & 0x07FF_FFFF
        else:
            continue
        data = words[at : at + count]
        at += count
        if count:
            yield register, data
        if register == _CMD and count and data[0] == _DESYNC:
            synced = False
