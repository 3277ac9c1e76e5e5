# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from itertools import pairwise

import pytest
from bitstream_support import compressed, frames, slow_crc, small, two_sections
from hypothesis import given
from hypothesis import strategies as st

from cm.device.native import bitstream as native
from cm.device.native import sim_crc
from cm.formats.bitstream import Device, ModuleIdentity, assemble_module, device_by_name, inspect, to_dma_words
from cm.formats.bitstream.errors import BitstreamError
from cm.formats.bitstream.module import identify_bytes
from cm.simulation.software.hardware.configuration_port import ConfigPort, PortError

WORD = st.integers(0, 2**32 - 1)


def device(name: str = "xc7z020") -> Device:
    found = device_by_name(name)
    assert found is not None
    return found


def words(data: bytes) -> bytes:
    return to_dma_words(data)


@given(cuts=st.lists(st.integers(0, 2000), max_size=8), source=st.sampled_from([small, two_sections, compressed]))
def test_pieces_of_any_size_give_the_same_result(cuts: list[int], source: object) -> None:
    data = words(source())  # type: ignore[operator]
    whole, port = ConfigPort(device()), ConfigPort(device())
    expected = whole.feed(data)
    edges = [0, *sorted(cuts), len(data)]
    found = [write for first, last in pairwise(edges) for write in port.feed(data[first:last])]
    assert tuple(found) == expected
    assert (port.frames, port.sections, port.errors) == (whole.frames, whole.sections, PortError.NONE)
    assert port.complete


def test_module_is_known_by_its_frames() -> None:
    port = ConfigPort(device())
    writes = port.feed(words(assemble_module("left_edge", model="edge")))
    assert writes[0].module == ModuleIdentity("left_edge", "edge")
    assert all(write.module is None for write in writes[1:])


def test_port_is_in_sync_until_desync() -> None:
    data = words(small())
    port = ConfigPort(device())
    port.feed(data[: len(data) // 2])
    assert port.synced
    assert not port.complete
    port.feed(data[len(data) // 2 :])
    assert not port.synced
    assert port.complete


def test_wrong_crc_sets_the_error_bit() -> None:
    data = bytearray(small())
    data[data.index(bytes.fromhex("30000001")) + 5] ^= 0x10
    port = ConfigPort(device())
    port.feed(words(bytes(data)))
    assert port.errors == PortError.CRC
    assert not port.complete


def test_other_idcode_sets_the_error_bit_and_no_frame_is_taken() -> None:
    port = ConfigPort(device("xc7z010"))
    assert port.feed(words(small())) == ()
    assert port.errors == PortError.IDCODE
    assert port.frames == 0


def test_words_that_are_not_packets_stop_the_port_until_reset() -> None:
    port = ConfigPort(device(), swapped=False)
    port.feed(bytes.fromhex("aa995566e0000000"))
    port.feed(bytes.fromhex("30008001000000 0d".replace(" ", "")))
    assert port.errors == PortError.PACKET
    assert port.sections == 0
    port.reset()
    assert port.errors == PortError.NONE
    assert not port.synced


def test_bytes_without_sync_do_nothing() -> None:
    port = ConfigPort(device())
    port.feed(bytes(1000))
    assert not port.synced
    assert not port.complete
    assert port.errors == PortError.NONE


@given(data=st.binary(max_size=400), swapped=st.booleans())
def test_port_takes_any_bytes(data: bytes, swapped: bool) -> None:
    port = ConfigPort(device(), swapped)
    port.feed(words(small())[:64] + data)
    assert port.frames >= 0


@given(st.text(min_size=1, max_size=40), st.text(max_size=40))
def test_identity_survives_the_frame(name: str, model: str) -> None:
    port = ConfigPort(device())
    data = assemble_module(name, model=model or None, size=1)
    assert port.feed(words(data))[0].module == ModuleIdentity(name, model or name)


def test_a_damaged_identity_is_not_recognised() -> None:
    frame = bytearray(assemble_module("edge", size=1))
    begin = frame.index(b"CM-RM")
    frame[begin + 10] ^= 1
    assert identify_bytes(bytes(frame[begin : begin + 404])) is None
    assert identify_bytes(bytes(12)) is None


def test_names_that_do_not_fit_a_frame_are_refused() -> None:
    with pytest.raises(ValueError, match="together over 256 bytes"):
        assemble_module("x" * 300)


def test_foreign_frames_name_no_module() -> None:
    assert identify_bytes(frames(1)[:404]) is None


@given(
    words_=st.lists(st.integers(0, 0xFFFFFFFF), max_size=70),
    register=st.integers(0, 31),
    start=st.integers(0, 2**32 - 1),
)
def test_the_ports_own_crc_is_that_of_the_bits_and_the_products(words_: list[int], register: int, start: int) -> None:
    import numpy as np

    data = np.array(words_, dtype=np.uint32)
    expected = slow_crc(register, words_, start)
    assert sim_crc.words(start, register, data) == expected
    assert not words_ or sim_crc.word(slow_crc(register, words_[:-1], start), register, words_[-1]) == expected
    assert native.crc(start, register, data.astype(">u4").tobytes()) == expected


@given(source=st.sampled_from([small, two_sections, compressed]), flip=st.data())
def test_what_verification_lets_through_the_port_takes(source: object, flip: st.DataObject) -> None:
    """Two readers that share no code: a flip that only one of them accepts shows a mistake."""
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
