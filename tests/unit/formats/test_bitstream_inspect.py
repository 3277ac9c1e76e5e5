# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import hashlib

import pytest
from bitstream_support import FRAME_BYTES, HERE, bit, compressed, frames, slow_crc, small, two_sections
from hypothesis import given
from hypothesis import strategies as st

from cm.formats.bitstream import (
    Container,
    CrcResult,
    FrameAddress,
    FrameRun,
    SharedFrame,
    assemble,
    convert,
    inspect,
)
from cm.formats.bitstream.geometry import decode_far, encode_far
from cm.formats.bitstream.idcodes import DEVICES, Device, Family
from cm.formats.bitstream.inspection_report import Footprint, Section

RCRC = (0x30008001, 7)
IDCODE = (0x30018001, 0x03727093)
DESYNC = (0x30008001, 13)
FDRI = (0x30004000 | 101, *([0] * 101))
NOP = 0x20000000


def codes(data: bytes) -> set[str]:
    return {item.code for item in inspect(data).problems}


def test_json_has_the_documented_keys() -> None:
    data = small(design="camera", part="7z020clg400")
    found = inspect(data).to_json()
    named = ("camera", "xc7z020", "0x03727093", "7series")
    assert (found["design"], found["device"], found["idcode"], found["family"]) == named
    assert (found["partial"], found["encrypted"]) == (True, False)
    assert found["sha256"] == hashlib.sha256(data).hexdigest()
    assert (found["sections"], found["frames"], found["crc"]) == (1, 1, "ok")
    assert (found["container"], found["compressed"], found["problems"]) == ("bit", False, [])
    assert (found["part"], found["date"]) == ("7z020clg400", "2024/01/01 00:00:00")
    assert found["length"] == len(data)
    assert inspect(small(user_id=0xC0FFEE)).to_json()["user_id"] == "0x00c0ffee"
    assert found["footprint"] == [{"block_type": 0, "row": 0, "column": 26, "frames": 1, "last_column": 26}]


def test_json_of_a_device_that_is_not_known_has_the_same_keys_and_says_null() -> None:
    words = convert(bit(0x30018001, 0x01C10093, *FDRI, *DESYNC), Container.BIN_SWAPPED)
    found = inspect(words + b"ab").to_json()
    assert found.keys() == inspect(small()).to_json().keys()
    nothing = {"device", "family", "design", "part", "date", "user_id"}
    assert {key for key, value in found.items() if value is None} == nothing
    assert (found["frames"], found["footprint"], found["sections"], found["crc"]) == (0, [], 1, "absent")
    assert inspect(words).sections == (Section(4, 428, 0),)
    assert found["problems"] == [
        {"code": "bitstream_container", "message": "2 bytes follow the last whole word"},
        {"code": "unknown_device", "message": "IDCODE 01C10093: neither 7-series nor UltraScale+"},
    ]


@pytest.mark.parametrize("form", [Container.BIN_SWAPPED, Container.BIN_STRAIGHT])
@pytest.mark.parametrize("partial", [True, False])
def test_bin_gives_the_same_findings(form: Container, partial: bool) -> None:
    plain, report = inspect(small(partial=partial)), inspect(convert(small(partial=partial), form))
    assert (report.device, report.frames, report.crc, report.footprint, report.partial, report.problems) == (
        (plain.device, plain.frames, plain.crc, plain.footprint, plain.partial, ())
    )


def test_all_sections_are_read() -> None:
    assert inspect(bit(*RCRC, *IDCODE, *FDRI)).sections == (Section(101, 428, 1),)  # DESYNC is missing
    report = inspect(two_sections())
    assert report.sections == (Section(161, 532, 1), Section(805, 948, 2))
    assert report.footprint == (Footprint(0, 0, 26, 1, 26), Footprint(1, 2, 3, 2))
    assert report.problems == ()


def test_compressed_frames_are_counted_where_they_go() -> None:
    report = inspect(compressed())
    assert report.compressed
    assert report.frames == 4  # one by FDRI, three by MFWR
    assert report.footprint == (Footprint(0, 0, 26, 2, 26), Footprint(0, 3, 2, 1))
    many = tuple(FrameAddress(0, 0, column, minor) for column in range(40) for minor in range(28))
    report = inspect(assemble("xc7z020", [SharedFrame(frames(1), many)]))
    assert (report.frames, len(report.footprint), report.problems) == (1 + 1120, 40, ())


def test_frames_written_twice_count_once_in_the_footprint() -> None:
    run = FrameRun(HERE, frames(3))
    report = inspect(assemble("xc7z020", [run, run]))
    assert report.frames == 6
    assert report.footprint == (Footprint(0, 0, 26, 3, 26),)
    for count in (1, 2):  # one frame that is the last of its column, with and without one that pushes it out
        at_end = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 26, 35), frames(count))])
        assert inspect(at_end).footprint == (Footprint(0, 0, 26, count, 26),)
    assert inspect(small(partial=False)).footprint == (Footprint(0, 0, 26, 1),)  # it may go where it wants to
    half = bit(*RCRC, *IDCODE, 0x30002001, 26 << 7 | 34, 0x30004000 | 350, *[0] * 350, *DESYNC)
    assert inspect(half).footprint == (Footprint(0, 0, 26, 3, 26),)  # what is not a whole frame reaches no further


def test_silicon_revision_does_not_matter() -> None:
    report = inspect(bit(*RCRC, 0x30018001, 0x23727093, *FDRI, *DESYNC))
    assert (report.device, report.problems) == ("xc7z020", ())


@pytest.mark.parametrize(
    "words",
    [
        pytest.param((0x30008001, 15), id="IPROG restarts the device"),
        pytest.param((0x30008001, 12), id="GCAPTURE"),
        pytest.param((0x30008002, 0, 0), id="two words for CMD"),
        pytest.param((0x28018001,), id="a read"),
        pytest.param((0x20000001,), id="a NOP with words"),
        pytest.param((0x3003C001, 0), id="a register that nobody writes"),
        pytest.param((0x50000010,), id="type 2 alone"),
        pytest.param((0x30004000, NOP), id="type 1 without its type 2"),
        pytest.param((0xE0000000,), id="a type that does not exist"),
        pytest.param((0,), id="a lone zero"),
        pytest.param((0x30002001, 0x80000000), id="no frame address"),
    ],
)
def test_packet_in_a_wrong_place_is_refused(words: tuple[int, ...]) -> None:
    assert "bitstream_packet" in codes(bit(*RCRC, *IDCODE, *words, *FDRI, *DESYNC))


CRC = slow_crc(2, [0] * 101, slow_crc(12, [0x03727093]))
CHECKED = (*RCRC, *IDCODE, *FDRI, 0x30000001, CRC)


NO_FRAMES = "no frame data: the bitstream would configure nothing"
START = (0x30008001, 5)
WHOLE = (*RCRC, *IDCODE, *FDRI, *START, *DESYNC)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ((*RCRC, *FDRI, *DESYNC), {
            "unknown_device": "no IDCODE is written: the device would not check that the bitstream is its own"}),
        ((*RCRC, *IDCODE, 0x30018001, 0x03722093, *FDRI, *DESYNC), {
            "wrong_device": "sections for different devices: 03727093, 03722093"}),
        ((*RCRC, 0x30018001, 0x03722093, *FDRI, *DESYNC), {
            "wrong_device": "the header says 7z020clg400, the IDCODE 03722093 is that of xc7z010"}),
        ((*RCRC, *IDCODE, *FDRI), {"bitstream_truncated": "the stream ends without DESYNC, after 108 words"}),
        ((*RCRC, *IDCODE, 0x30004000, 0x50000FFF, 1, 2, 3), {
            "bitstream_truncated": "the stream ends inside a packet, after 11 words", "frames_incomplete": NO_FRAMES}),
        ((*RCRC, *IDCODE, *DESYNC), {"frames_incomplete": NO_FRAMES}),
        ((*RCRC, *IDCODE, 0x30002001, 0xD00, 0x30004003, 1, 2, 3, *DESYNC), {
            "frames_incomplete": "word 8: 3 words of frame data at FAR 00000D00 are not whole frames of 101 words"}),
        ((*CHECKED, *DESYNC), {}),
        ((*CHECKED, *RCRC, *DESYNC), {}),
        ((*CHECKED[:-1], CRC ^ 1, *DESYNC), {
            "crc_mismatch": f"word 108: CRC {CRC ^ 1:08X} in the stream, {CRC:08X} computed"}),
        ((*CHECKED, 0x3000A001, 0x100, *DESYNC), {
            "crc_missing": "word 112: 1 register writes before DESYNC are covered by no CRC"}),
        ((*IDCODE, *CHECKED, *DESYNC), {
            "crc_missing": "word 4: 1 register writes before RCRC are covered by no CRC"}),
        ((*CHECKED, 0x30000001, 0, *DESYNC), {"bitstream_packet": "word 110: a CRC that covers nothing"}),
        ((*RCRC, *CHECKED, *DESYNC), {"bitstream_packet": "word 4: RCRC follows RCRC"}),
        ((*WHOLE, 0xAA995566, *WHOLE), {
            "bitstream_container": "word 219: a second image follows the first: give one at a time"}),
        ((*RCRC, *IDCODE, *FDRI, 0x30014002, 0, 5, *DESYNC), {
            "bitstream_packet": "word 108: an MFWR packet carries data other than zeros"}),
        ((*RCRC, *IDCODE, *FDRI, *DESYNC, 0x12345678), {
            "bitstream_packet": "word 110: 12345678 is outside of sync and is not padding"}),
        ((*RCRC, *IDCODE, *FDRI, *[0] * 202, *DESYNC), {}),  # padding of a debug bitstream
        ((*RCRC, *IDCODE, *FDRI, *[0] * 201, *DESYNC), {
            "bitstream_packet": "201 zero words between packets are not padding frames"}),
        ((*RCRC, *IDCODE, 0x30002001, 0x80000000, *FDRI, *FDRI, *DESYNC), {
            "bitstream_packet": "word 8: 80000000 is not a frame address"}),
        ((*RCRC, *IDCODE, 0x30002001, 6 << 7 | 28, *FDRI, *DESYNC), {
            "bitstream_packet": "word 8: frame 28 of block type 0 row 0 column 6, which has 28 in this device"}),
        ((*RCRC, *IDCODE, 0x30002001, 74 << 7, *FDRI, *DESYNC), {"bitstream_packet":
            "word 8: frame 0 of block type 0 row 0 column 74, which does not exist in this device"}),
    ],
)  # fmt: skip
def test_what_is_not_sound_is_refused_with_its_place(words: tuple[int, ...], wanted: dict[str, str]) -> None:
    report = inspect(bit(*words))
    assert [(item.code, item.message) for item in report.problems] == list(wanted.items())
    good = CrcResult.OK if CRC in words else CrcResult.ABSENT
    assert report.crc is (CrcResult.WRONG if "crc_mismatch" in wanted else good)


@pytest.mark.parametrize("counts", [(8, 4, 4), (14, 14, 14)])  # as Vivado writes for 7-series and UltraScale+
def test_multiple_frame_writes_of_any_length_are_accepted(counts: tuple[int, ...]) -> None:
    packets = [
        word for minor, count in enumerate(counts) for word in (0x30002001, minor, 0x30014000 | count, *[0] * count)
    ]
    report = inspect(bit(*RCRC, *IDCODE, *FDRI, *packets, *DESYNC))
    assert report.problems == ()
    assert report.footprint == (Footprint(0, 0, 0, 3, 0),)


def test_bitstream_of_another_family_is_refused_whatever_it_looks_like() -> None:
    words, none = (0x30018001, 0x01C10093, 0x30016001, 0, 0x30004001, 0, *DESYNC), "neither 7-series nor UltraScale+"
    for packets, found in ((words, "IDCODE 01C10093, part 3s100ecp132"), (words[2:], "part 3s100ecp132")):  # encrypted
        (problem,) = inspect(bit(*packets).replace(b"7z020clg400", b"3s100ecp132")).problems
        assert (problem.code, problem.message) == ("unknown_device", f"{found}: {none}")


def test_encrypted_bitstream_is_recognised() -> None:
    cipher = [0x5A5A5A5A] * 50
    report = inspect(bit(*IDCODE, 0x30016004, 1, 2, 3, 4, 0x30034001, len(cipher), *cipher, NOP))
    assert report.encrypted is True
    assert report.problems == ()
    assert inspect(bit(*IDCODE, 0x30016004, 1, 2, 3, 4, *DESYNC)).encrypted is True  # there is an IV


@pytest.mark.parametrize("family", list(Family))
@given(data=st.data())
def test_frame_addresses_survive_encoding(family: Family, data: st.DataObject) -> None:
    layout = family.far
    fields = (layout.block_type, layout.row, layout.column, layout.minor)
    address = FrameAddress(*(data.draw(st.integers(0, (1 << width) - 1)) for _, width in fields))
    assert decode_far(encode_far(address, family), family) == address
    assert encode_far(address, family) & ~layout.used == 0


def test_frame_addresses_of_real_bitstreams() -> None:
    # From the two partials of a Z7020 design with two regions: bottom half (row bit 5), columns 26 and 28.
    assert decode_far(0x00400D00, Family.SERIES7) == FrameAddress(0, 32, 26)
    assert decode_far(0x00400E00, Family.SERIES7) == FrameAddress(0, 32, 28)
    assert decode_far(0x0000250D, Family.ULTRASCALE_PLUS) == FrameAddress(0, 0, 37, 13)


@pytest.mark.parametrize("device", DEVICES, ids=lambda device: device.name)
def test_every_device_is_recognised(device: Device) -> None:
    frame = bytes(4 * device.family.frame_words)
    report = inspect(assemble(device, [FrameRun(HERE, frame)]))
    assert (report.device, report.idcode, report.family) == (device.name, device.idcode, device.family)
    assert report.problems == ()


@pytest.mark.parametrize(("device", "there", "frame"), [("xczu3eg", FRAME_BYTES, 372), ("xc7z020", 0, FRAME_BYTES)])
def test_frame_size_is_that_of_the_family(device: str, there: int, frame: int) -> None:
    with pytest.raises(ValueError, match=f"^{there} bytes are not whole frames of {frame} bytes$"):
        assemble(device, [FrameRun(HERE, bytes(there))])


@given(
    st.lists(
        st.tuples(st.integers(0, 1), st.integers(0, 3), st.integers(0, 5), st.integers(1, 3)), min_size=1, max_size=6
    )
)
def test_what_is_assembled_is_found_again(runs: list[tuple[int, int, int, int]]) -> None:
    expected: dict[tuple[int, int, int], int] = {}
    for block, row, column, count in runs:
        expected[block, row, column] = max(count, expected.get((block, row, column), 0))
    report = inspect(assemble("xc7z020", [FrameRun(FrameAddress(*run[:3]), frames(run[3])) for run in runs]))
    assert {(item.block_type, item.row, item.column): item.frames for item in report.footprint} == expected
    assert report.frames == sum(run[3] for run in runs)
    assert report.problems == ()
