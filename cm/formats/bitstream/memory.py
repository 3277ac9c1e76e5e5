# SPDX-License-Identifier: Apache-2.0
"""The configuration memory of a 7-series device: what loaded bitstreams leave in its frames (UG470 chapter 5)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cm.formats.bitstream.container import Container, Image, Source, open_image
from cm.formats.bitstream.devices import Device, Family, device_by_idcode
from cm.formats.bitstream.errors import BadPacket, UnknownDevice
from cm.formats.bitstream.geometry import FrameOrder, decode_far, frame_order
from cm.formats.bitstream.inspect import inspect
from cm.formats.bitstream.packets import frame_writes
from cm.formats.bitstream.verify import Expectation, verify
from cm.formats.xray.frames import BYTES, from_bytes

_IN_ROWS = (0, 1)  # block types of frames that belong to a place: logic and routing, contents of block RAM


class FrameMemory:
    """Frames by their address (FAR), as `cm.formats.xray` has them: numbers."""

    def __init__(self, device: Device) -> None:
        """Raises UnknownDevice for one that is not of the 7 series, or whose columns are not known."""
        order = frame_order(device.name, device.family)
        if device.family is not Family.SERIES7 or order is None:
            raise UnknownDevice(f"{device.name}: the frames of its columns are not known")
        self.frames: dict[int, int] = {}
        self._order = order

    def load(self, stream: bytes) -> set[int]:
        """Take a bitstream as it is in memory for DMA (``66 55 99 AA``), otherwise as `take`."""
        return self.take(
            Image(Container.BIN_SWAPPED, None, memoryview(stream)[: len(stream) // 4 * 4], 0, swapped=True)
        )

    def take(self, image: Image) -> set[int]:
        """Take a bitstream that has been found good; returns the addresses of the frames it wrote.

        Raises BadPacket for a frame address that the device does not have.
        """
        written: set[int] = set()
        held = 0
        for write in frame_writes(image):
            frames = [from_bytes(write.data[at : at + BYTES]) for at in range(0, len(write.data), BYTES)]
            # The last frame of a run stays in the port: it pushes out the one before, and is what MFWR repeats.
            held = frames[-1] if frames else held
            for address, frame in self._placed(write.far, frames[:-1] or [held] * write.repeated):
                self.frames[address] = frame
                written.add(address)
        return written

    def _placed(self, far: int, frames: Sequence[int]) -> Iterator[tuple[int, int]]:
        """Frames with their addresses, one after the other from `far` on; those after the end of a row are dropped."""
        if decode_far(far, Family.SERIES7).block_type not in _IN_ROWS:
            return  # Vivado's bitstreams write some; none of the database's features lies there
        if far not in self._order.place:
            raise BadPacket(f"frame address 0x{far:08x} does not exist in this device")
        for number, address in self._order.run(far):
            if number >= len(frames):
                return
            yield address, frames[number]


def frames_in(source: Source) -> tuple[Device, dict[int, int]]:
    """Return the device of a bitstream, and the frames that it writes, by their address.

    Raises the bitstream's first refusal; UnknownDevice as `FrameMemory` does.
    """
    report = inspect(source)
    verify(report, Expectation())
    device = device_by_idcode(report.idcode) if report.idcode is not None else None
    if device is None:
        raise UnknownDevice(f"{report.device or 'a device without an IDCODE'}: its frames are not known")
    memory = FrameMemory(device)
    written = memory.take(open_image(source))
    return device, {address: memory.frames[address] for address in sorted(written)}


def frames_of(image: Image, order: FrameOrder) -> dict[int, bytes]:
    """The frames that a good bitstream leaves in the device, by FAR; those of other block types are left out."""
    size = 4 * order.family.frame_words
    found: dict[int, bytes] = {}
    held = b""
    for write in frame_writes(image):
        data = [write.data[at : at + size] for at in range(0, len(write.data), size)]
        held = data[-1] if data else held
        frames = data[:-1] or [held] * write.repeated
        if write.far in order.place:
            # the last frame of a run only pushes the one before it out of the port, which holds it then
            for number, far in order.run(write.far):
                if number >= len(frames):
                    break
                found[far] = frames[number]
    return found
