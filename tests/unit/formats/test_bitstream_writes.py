# SPDX-License-Identifier: Apache-2.0
"""The frame data of a bitstream, and the resulting contents of a device's configuration memory."""

from __future__ import annotations

import struct

import pytest
from bitstream_support import FRAME_BYTES, HERE, bit, frames, two_sections

from cm.formats.bitstream import (
    FrameAddress,
    FrameRun,
    SharedFrame,
    assemble,
    convert,
    device_by_name,
    open_image,
    to_dma_words,
)
from cm.formats.bitstream.container import Container
from cm.formats.bitstream.errors import BadPacket
from cm.formats.bitstream.geometry import encode_far, frame_order
from cm.formats.bitstream.idcodes import Family
from cm.formats.bitstream.memory import FrameMemory, frames_of
from cm.formats.bitstream.packets import FrameWrite, frame_writes

FAR, FDRI, CMD, DESYNC = 0x30002001, 0x30004000, 0x30008001, 13


def far(*address: int) -> int:
    return encode_far(FrameAddress(*address), Family.SERIES7)


def memory() -> FrameMemory:
    device = device_by_name("xc7z020")
    assert device is not None
    return FrameMemory(device)


def held(made: FrameMemory) -> dict[int, bytes]:
    """Frames by address, as words in the order of a bitstream."""
    little = {address: frame.to_bytes(FRAME_BYTES, "little") for address, frame in made.frames.items()}
    return {address: struct.pack(">101I", *struct.unpack("<101I", frame)) for address, frame in little.items()}


def loaded(data: bytes) -> dict[int, bytes]:
    made = memory()
    written = made.load(bytes(convert(data, Container.BIN_SWAPPED)))
    assert written == made.frames.keys()
    return held(made)


def test_each_run_is_a_write_in_the_order_of_the_bitstream() -> None:
    long = assemble("xc7z020", [FrameRun(HERE, frames(25))])  # of a type 2 packet
    assert list(frame_writes(open_image(long))) == [FrameWrite(encode_far(HERE, Family.SERIES7), frames(25))]
    once = [FrameWrite(encode_far(HERE, Family.SERIES7), frames(1)), FrameWrite(far(1, 2, 3), frames(2, b"more"))]
    assert list(frame_writes(open_image(two_sections()))) == once


@pytest.mark.parametrize("pieces", [(202,), (101, 101), (50, 152), (1, 200, 1)])
def test_a_run_in_several_packets_is_one_write(pieces: tuple[int, ...]) -> None:
    words = list(struct.unpack(">202I", frames(2)))
    packets: list[int] = []
    for count in pieces:
        packets += [FDRI | count, *words[:count]]
        del words[:count]
    data = bit(FAR, far(0, 0, 26), *packets, CMD, DESYNC)
    assert list(frame_writes(open_image(data))) == [FrameWrite(far(0, 0, 26), frames(2))]


def test_the_last_frame_of_a_run_only_pushes_out_the_one_before() -> None:
    data = assemble("xc7z020", [FrameRun(HERE, frames(3))])
    assert loaded(data) == {far(0, 0, 26, 0): frames(3)[:FRAME_BYTES], far(0, 0, 26, 1): frames(3)[404:808]}


def test_a_compressed_bitstream_leaves_its_frame_at_every_address() -> None:
    addresses = [FrameAddress(0, 0, 26), FrameAddress(0, 0, 26, 1), FrameAddress(0, 33, 2)]
    data = assemble("xc7z020", [SharedFrame(frames(1), tuple(addresses))])
    assert loaded(data) == {encode_far(address, Family.SERIES7): frames(1) for address in addresses}


def test_frames_outside_the_rows_are_passed_over() -> None:
    runs = [FrameRun(FrameAddress(2, 0, 0), frames(2, b"none")), FrameRun(HERE, frames(2))]
    assert loaded(assemble("xc7z020", runs)) == {encode_far(HERE, Family.SERIES7): frames(2)[:FRAME_BYTES]}


def test_two_frames_after_a_row_are_discarded() -> None:
    last = FrameAddress(0, 0, 73, 41)
    data = frames(5)
    assert loaded(assemble("xc7z020", [FrameRun(last, data)])) == {
        encode_far(last, Family.SERIES7): data[:FRAME_BYTES],
        far(0, 32, 0): data[3 * FRAME_BYTES : 4 * FRAME_BYTES],
    }


def test_an_address_that_the_device_does_not_have_is_refused() -> None:
    data = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 127), frames(2))])
    for image in (open_image(data), to_dma_words(data)):
        with pytest.raises(BadPacket, match=r"^frame address 0x00003f80 does not exist in this device$"):
            memory().load(image)
    assert (
        frames_of(open_image(data), frame_order("xc7z020", Family.SERIES7)) == {}
    )  # passed over where nothing is loaded


def test_bytes_behind_the_last_whole_word_are_not_taken() -> None:
    data = to_dma_words(assemble("xc7z020", [FrameRun(HERE, frames(2))]))
    assert memory().load(data + b"abc") == memory().load(data)
