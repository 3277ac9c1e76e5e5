# SPDX-License-Identifier: Apache-2.0
"""What a device does with packets: frames that arrive, the bits of STAT, sync and DESYNC."""

from __future__ import annotations

import struct
from itertools import pairwise

import pytest
from bitstream_support import compressed, small, two_sections
from hypothesis import given
from hypothesis import strategies as st

from cm.formats.bitstream import Device, ModuleIdentity, assemble_module, device_by_name, inspect, to_dma_words
from cm.formats.bitstream.errors import BitstreamError
from cm.formats.bitstream.readback import closing_words, request_words
from cm.simulation.software.hardware.configuration_port import ConfigPort, PortError


def device(name: str = "xc7z020") -> Device:
    found = device_by_name(name)
    assert found is not None
    return found


@given(cuts=st.lists(st.integers(0, 500), max_size=8), source=st.sampled_from([small, two_sections, compressed]))
def test_pieces_of_any_size_give_the_same_result(cuts: list[int], source: object) -> None:
    data = to_dma_words(source())  # type: ignore[operator]
    whole, port = ConfigPort(device()), ConfigPort(device())
    expected = whole.feed(data)
    edges = [0, *sorted(4 * cut for cut in cuts), len(data)]
    assert [write for first, last in pairwise(edges) for write in port.feed(data[first:last])] == expected
    assert (port.frames, port.sections, port.errors) == (whole.frames, whole.sections, PortError.NONE)
    assert port.complete


@given(st.text(min_size=1, max_size=40), st.text(max_size=40))
def test_a_module_is_known_by_its_first_frames(name: str, model: str) -> None:
    first, *others = ConfigPort(device()).feed(to_dma_words(assemble_module(name, model=model or None, size=50_000)))
    assert first.module == ModuleIdentity(name, model or name)
    assert {write.module for write in others} == {None}


def test_a_port_is_in_sync_until_desync() -> None:
    data, port = to_dma_words(small()), ConfigPort(device())
    port.feed(bytes(1000))
    assert (port.synced, port.complete, port.errors) == (False, False, PortError.NONE)
    port.feed(data[: len(data) // 8 * 4])
    assert (port.synced, port.complete) == (True, False)
    port.feed(data[len(data) // 8 * 4 :])
    assert (port.synced, port.complete) == (False, True)


def wrong_crc() -> bytes:
    data = bytearray(two_sections())
    data[data.index(bytes.fromhex("30000001")) + 5] ^= 0x10
    return to_dma_words(bytes(data))


@pytest.mark.parametrize(
    ("part", "words", "error", "sections", "arrived"),
    [
        ("xc7z020", wrong_crc(), PortError.CRC, 2, 1),
        ("xc7z010", to_dma_words(small()), PortError.IDCODE, 1, 0),
        ("xc7z020", struct.pack("<4I", 0xAA995566, 0xE0000000, 0x30008001, 13), PortError.PACKET, 0, 0),
        ("xc7z020", struct.pack("<2I", 0xAA995566, 0x28006000), PortError.PACKET, 0, 0),
    ],
    ids=["crc", "idcode", "packet", "read without RCFG"],
)
def test_an_error_is_shown_until_reset_and_no_frame_after_it_counts(
    part: str, words: bytes, error: PortError, sections: int, arrived: int
) -> None:
    port = ConfigPort(device(part))
    assert len(port.feed(words)) == arrived
    assert (port.errors, port.sections, port.complete) == (error, sections, False)
    assert port.sound is not None
    assert len(ConfigPort(device(part)).feed(words[: 4 * port.sound])) == arrived
    port.reset()
    assert (port.errors, port.synced, port.sound) == (PortError.NONE, False, None)


@pytest.mark.parametrize("part", ["xc7z020", "xczu3eg"])
def test_a_read_is_asked_for_between_packets_and_the_port_goes_on(part: str) -> None:
    port = ConfigPort(device(part))
    port.feed(struct.pack(f"<{len(asked := words(request_words(device(part).family, 0x480, 3)))}I", *asked))
    assert port.asked is not None
    assert (port.asked[0], port.synced, port.errors) == (0x480, True, PortError.NONE)
    assert port.asked[1] >= 4 * device(part).family.frame_words
    port.feed(struct.pack(f"<{len(closing := words(closing_words()))}I", *closing))
    assert port.complete


def words(data: bytes) -> tuple[int, ...]:
    return struct.unpack(f">{len(data) // 4}I", data)


@given(data=st.binary(max_size=400))
def test_a_port_takes_any_bytes(data: bytes) -> None:
    port = ConfigPort(device())
    port.feed(to_dma_words(small())[:64] + data)
    assert port.frames >= 0


@given(source=st.sampled_from([small, two_sections, compressed]), flip=st.data())
def test_what_verification_lets_through_the_port_takes(source: object, flip: st.DataObject) -> None:
    data = bytearray(source())  # type: ignore[operator]
    at = flip.draw(st.integers(0, len(data) - 1))
    data[at] ^= 1 << flip.draw(st.integers(0, 7))
    try:
        report = inspect(bytes(data))
    except BitstreamError:
        return
    if report.problems:
        return
    port = ConfigPort(device())
    port.feed(to_dma_words(bytes(data)))
    assert port.complete
    assert port.sections == len(report.sections)
    assert report.compressed or port.frames == report.frames
