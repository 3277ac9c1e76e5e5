# SPDX-License-Identifier: Apache-2.0
"""The configuration memory of a device: what loaded bitstreams leave in its frames (UG470 chapter 5).

Frames are numbers, as `cm.formats.xray` has them: bit b of word w is bit 32·w + b. So they are in memory for DMA.
"""

from __future__ import annotations

from cm.formats.bitstream.container import Container, Image, Source, open_image
from cm.formats.bitstream.errors import BadPacket, UnknownDevice
from cm.formats.bitstream.geometry import IN_ROWS, FrameOrder, decode_far, frame_order
from cm.formats.bitstream.idcodes import Device, Family, device_by_idcode
from cm.formats.bitstream.inspect import inspect
from cm.formats.bitstream.packets import frame_writes
from cm.formats.bitstream.verify import Expectation, verify
from cm.formats.xray.frames import from_bytes


def dma_image(words: bytes | memoryview) -> Image:
    """A bitstream as it is in memory for DMA (``66 55 99 AA``)."""
    return Image(Container.BIN_SWAPPED, None, memoryview(words)[: len(words) // 4 * 4], 0, swapped=True)


def frames_of(image: Image, order: FrameOrder, strict: bool = False) -> dict[int, int]:
    """The frames that a good bitstream leaves in the device, by FAR.

    Frames of other block types are left out, since none of them belongs to a place (Vivado's bitstreams write some),
    and those after the end of a row. An address that the device does not have is left out, or with `strict` BadPacket.
    """
    size = 4 * order.family.frame_words
    found: dict[int, int] = {}
    held = 0
    for write in frame_writes(image):
        frames = [from_bytes(write.data[at : at + size]) for at in range(0, len(write.data), size)]
        # The last frame of a run stays in the port: it pushes out the one before, and is what MFWR repeats.
        held = frames[-1] if frames else held
        frames = frames[:-1] or [held] * write.repeated
        if write.far not in order.place:
            if strict and decode_far(write.far, order.family).block_type in IN_ROWS:
                raise BadPacket(f"frame address 0x{write.far:08x} does not exist in this device")
            continue
        for number, far in order.run(write.far):
            if number >= len(frames):
                break
            found[far] = frames[number]
    return found


class FrameMemory:
    """Frames of a 7-series device by their address (FAR)."""

    def __init__(self, device: Device) -> None:
        """Raises UnknownDevice for one that is not of the 7 series, or whose columns are not known."""
        order = frame_order(device.name, device.family)
        if device.family is not Family.SERIES7 or order is None:
            raise UnknownDevice(f"{device.name}: the frames of its columns are not known")
        self.frames: dict[int, int] = {}
        self._order = order

    def load(self, bitstream: bytes | memoryview | Image) -> set[int]:
        """Take a good bitstream, opened or as `dma_image`; returns the addresses of the frames it wrote.

        Raises BadPacket for a frame address that the device does not have.
        """
        image = bitstream if isinstance(bitstream, Image) else dma_image(bitstream)
        written = frames_of(image, self._order, strict=True)
        self.frames.update(written)
        return set(written)


def frames_in(source: Source) -> tuple[Device, dict[int, int]]:
    """Return the device of a bitstream, and the frames that it writes, by their address.

    Raises the bitstream's first refusal; UnknownDevice as `FrameMemory` does.
    """
    report = inspect(source)
    verify(report, Expectation())
    assert report.idcode is not None  # else it was refused
    device = device_by_idcode(report.idcode)
    if device is None:
        raise UnknownDevice(f"{report.device or f'IDCODE {report.idcode:08X}'}: its frames are not known")
    memory = FrameMemory(device)
    memory.load(open_image(source))
    return device, dict(sorted(memory.frames.items()))
