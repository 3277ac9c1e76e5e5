# SPDX-License-Identifier: Apache-2.0
"""Other people's files: forms that real bitstreams have, and wrong ones that resemble them."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from bitstream_support import bit, frames, slow_crc, small

from cm.formats.bitstream import (
    Container,
    Expectation,
    FrameAddress,
    FrameRun,
    assemble,
    convert,
    device_by_name,
    footprint_of,
    inspect,
    refusals,
)
from cm.formats.bitstream.errors import NoSync, UnknownDevice
from cm.formats.bitstream.geometry import geometry_of
from cm.formats.bitstream.idcodes import Family, base_name, family_of, package_of
from cm.formats.bitstream.packets import type1
from cm.schema.model import FrameRange

RCRC = (0x30008001, 7)
IDCODE = (0x30018001, 0x03727093)
FAR = (0x30002001, 0)
FDRI = (0x30004000 | 101, *([5] * 101))
DESYNC = (0x30008001, 13)


def codes(data: bytes, expect: Expectation | None = None) -> list[str]:
    return [item.code for item in refusals(inspect(data), expect or Expectation())]


def checked(*before: int, after: tuple[int, ...] = ()) -> bytes:
    """A bitstream with `before` ahead of RCRC, where no CRC covers it; the rest has a good CRC."""
    body = [(12, [0x03727093]), (1, [0]), (2, [5] * 101)]
    crc = 0
    for register, words in body:
        crc = slow_crc(register, words, crc)
    return bit(*before, *RCRC, *IDCODE, *FAR, *FDRI, *after, type1(0, 1), crc, *DESYNC)


@pytest.mark.parametrize("value", [0x00B, 0x26B])
def test_flash_settings_may_stand_before_the_first_crc(value: int) -> None:
    assert codes(checked(0x3003E001, value, 0x30008001, 0x12)) == []


@pytest.mark.parametrize("flip", range(32))
def test_flash_settings_with_a_flipped_bit_are_refused(flip: int) -> None:
    assert codes(checked(0x3003E001, 0x26B ^ 1 << flip, 0x30008001, 0x12)) == ["crc_missing"]


def test_crc_of_a_debug_bitstream_is_that_of_its_frames_without_the_debug_words() -> None:
    lout, fill = (type1(8, 1), 0x1234), [0] * 202
    crc = 0
    for register, words in [(12, [0x03727093]), (1, [0]), (2, [5] * 101), (2, fill), (2, [5] * 101)]:
        crc = slow_crc(register, words, crc)
    end = (type1(0, 1), crc, *DESYNC)
    body = (*RCRC, *IDCODE, *FAR, *FDRI, *lout, *fill, *FDRI, *lout)
    assert codes(bit(*lout, *body, *end)) == []
    assert codes(bit(*lout, *body, end[0], crc ^ 4, *DESYNC)) == ["crc_mismatch"]


@pytest.mark.parametrize(
    ("part", "idcode", "name", "family"),
    [
        ("XA7Z020", None, "xc7z020", Family.SERIES7),
        ("xq7k70t", None, "xc7k70t", Family.SERIES7),
        ("xc7z020-1CLG400C", None, "xc7z020", Family.SERIES7),
        ("xczu7eg", None, "xczu7ev", Family.ULTRASCALE_PLUS),
        ("xczu2cg-sbva484-1-e", None, "xczu2eg", Family.ULTRASCALE_PLUS),
        ("xck26-sfvc784-2LV-c", None, "xck26", Family.ULTRASCALE_PLUS),
        ("xc7vx485tffg1157", None, "xc7vx485t", Family.SERIES7),
        (" 7a35ticsg324 ", None, "xc7a35t", Family.SERIES7),
        ("xqzu9eg", None, "xczu9eg", Family.ULTRASCALE_PLUS),
        ("xczu28dr-ffvg1517", None, "xczu28dr", Family.ULTRASCALE_PLUS),
        ("xcku5p-ffva676", None, "xcku5p", Family.ULTRASCALE_PLUS),
        ("xqku5p", None, "xqku5p", Family.ULTRASCALE_PLUS),
        ("xcau10p", None, "xcau10p", Family.ULTRASCALE_PLUS),
        ("xck99-sfvc784", None, "xck99", Family.ULTRASCALE_PLUS),
        ("3s100ecp132-1", 0x03601093, "3s100ecp132", None),  # what the part says goes before
        ("", 0x03601093, "", Family.SERIES7),
        ("", 0x13701093, "", Family.SERIES7),
        ("", 0x14A01093, "", Family.ULTRASCALE_PLUS),
        ("", 0x04801093, "", None),
        ("", None, "", None),
        ("xc7z020", 0x04A43093, "xc7z020", Family.ULTRASCALE_PLUS),  # an IDCODE that is known goes before all
    ],
)
def test_a_part_or_else_an_idcode_leads_to_the_family(
    part: str, idcode: int | None, name: str, family: Family | None
) -> None:
    assert base_name(part) == name
    assert family_of(idcode, part or None) == family


def test_an_idcode_identifies_a_device_that_is_not_known() -> None:
    data = convert(bit(0x30018001, 0x04A11093, 0x30004000 | 93, *[0] * 93, *DESYNC), Container.BIN_SWAPPED)
    assert codes(data, Expectation("xczu28dr")) == ["unknown_device"]
    assert codes(data, Expectation("xczu28dr", idcode=0x14A11093)) == []
    assert codes(data, Expectation("xczu28dr", idcode=0x04A12093)) == ["wrong_device"]


@pytest.mark.parametrize(
    ("part", "package"),
    [
        ("7z020clg400", "cl400"),
        ("xc7z020clg484-1", "cl484"),
        ("7a35ticsg324", "cs324"),
        ("7k325tffg900", "ff900"),
        ("xczu7ev-ffvc1156-2-e", "ffvc1156"),
        ("xck26-sfvc784-2LV-c", "sfvc784"),
        ("xc7z020", None),
        ("k26", None),
    ],
)
def test_package_is_read_from_the_part(part: str, package: str | None) -> None:
    assert package_of(part) == package


def test_bitstream_for_another_package_is_refused_where_the_board_names_its_own() -> None:
    data = small(part="7z020clg484")
    assert codes(data, Expectation("xc7z020")) == []
    assert codes(data, Expectation("xc7z020clg484-1")) == []
    found = refusals(inspect(data), Expectation("xc7z020clg400-1"))
    assert [item.code for item in found] == ["wrong_device"]
    assert "package cl484; meant for xc7z020clg400-1, package cl400" in found[0].message


def test_encrypted_file_that_hides_its_idcode_loads_where_that_is_permitted() -> None:
    hidden = bit(0x30016004, 1, 2, 3, 4, 0x30034001, 4, 9, 9, 9, 9)
    data = convert(hidden, Container.BIN_SWAPPED)
    assert codes(data, Expectation("xc7z020", partial=True)) == ["unknown_device", "encrypted"]
    assert codes(data, Expectation("xc7z020", partial=True, allow_encrypted=True)) == []


@pytest.mark.parametrize(
    ("set_to", "expected", "wanted"),
    [
        ("0X00C0FFEE", 0xC0FFEE, []),
        ("0X00C0FFEE", 0xBADCAFE, ["wrong_static"]),
        ("0X00C0FFEE", 0xFFFFFFFF, []),  # never set, in one and in the other
        ("0XFFFFFFFF", 0xBADCAFE, []),
    ],
)
def test_user_ids_are_compared_where_both_are_set(set_to: str, expected: int, wanted: list[str]) -> None:
    data = small().replace(b"UserID=0XFFFFFFFF", f"UserID={set_to}".encode())
    assert codes(data, Expectation(user_id=expected)) == wanted


def pdi(*, partial: bool = False) -> bytes:
    """The headers of a Versal image by bootgen: boot header and image header table."""
    table = bytearray(0x80)
    for at, word in ((0x18, 0x14CA8093), (0x20, 0x11223344), (0x24, 0x55667788), (0x28, 0x50504449)):
        struct.pack_into("<I", table, at, word)
    if partial:
        return bytes(table) + bytes(1000)
    header = bytearray(0xF70)
    header[0x10:0x18] = bytes.fromhex("665599aa") + b"XNLX"
    struct.pack_into("<I", header, 0xC4, len(header))
    return bytes(header + table)


@pytest.mark.parametrize("partial", [True, False])
def test_versal_image_is_named_and_refused(partial: bool) -> None:
    with pytest.raises(UnknownDevice, match=r"Versal \.pdi \(IDCODE 14CA8093.*UID 11223344, parent UID 55667788"):
        inspect(pdi(partial=partial))


def test_versal_image_that_ends_in_its_header_is_refused() -> None:
    told = r"^a Versal \.pdi whose image header table is damaged or missing; Versal is not supported$"
    for length in (0x18, 0xC4, 0xF70, 0xF80):
        with pytest.raises(UnknownDevice, match=told):
            inspect(pdi()[:length])


@pytest.mark.parametrize("partial", [True, False])
def test_two_concatenated_images_are_refused(partial: bool) -> None:
    one = convert(small(partial=partial), Container.BIN_SWAPPED)
    assert codes(one) == []
    assert codes(one + one) == ["bitstream_container"]


def test_file_that_is_not_a_bitstream_is_refused_from_its_head() -> None:
    with pytest.raises(NoSync, match=r"/dev/zero: neither a \.bit"):
        inspect(Path("/dev/zero"))  # has no end


# Words that a read-back of the whole device gives: UG470 table 1-1, UG585, UG570; two frames of padding at the
# end of each row of a block type, and one before all.
READBACK = {
    "xc7z010": 520453,
    "xc7z020": 1010909,
    "xc7z030": 1494497,
    "xc7a50t": 547521,
    "xc7a100t": 955965,
    "xc7a200t": 2432181,
    "xc7k70t": 752349,
    "xc7k160t": 1672661,
    "xczu3eg": 1391652 + 93,
}


@pytest.mark.parametrize(("device", "words"), READBACK.items())
def test_columns_of_a_device_add_up_to_what_it_reads_back(device: str, words: int) -> None:
    known, geometry = device_by_name(device), geometry_of(device)
    assert known is not None
    assert geometry is not None
    rows = [row for (block_type, _), row in geometry.rows.items() if block_type < 2]
    total = sum(row.starts[-1] + 2 for row in rows) + 1
    assert total * known.family.frame_words == words


def region(first: int, last: int, row: int = 32) -> tuple[FrameRange, ...]:
    return (FrameRange(block_type=0, row=row, column_first=first, column_last=last),)


@pytest.mark.parametrize("column", range(74))
def test_one_frame_more_than_a_column_has_is_refused(column: int) -> None:
    geometry = geometry_of("xc7z020")
    assert geometry is not None
    row = geometry.row(0, 32)
    assert row is not None
    width = row.frames(column)
    expect = Expectation(footprint=region(column, column))
    address = FrameAddress(0, 32, column)
    fits = assemble("xc7z020", [FrameRun(address, frames(width + 1))])  # the last only pushes the one before it out
    assert codes(fits, expect) == []
    assert footprint_of(inspect(fits)) == expect.footprint
    if column < 73:
        (found,) = refusals(inspect(assemble("xc7z020", [FrameRun(address, frames(width + 2))])), expect)
        assert f"{width + 2} frames from block type 0 row 32 column {column} into column {column + 1};" in found.message


@pytest.mark.parametrize(("device", "last", "padding"), [("xc7z020", 73, 1), ("xczu3eg", 103, 4)])
def test_behind_the_end_of_a_row_is_padding_which_is_not_a_frame_of_anything(
    device: str, last: int, padding: int
) -> None:
    known, geometry = device_by_name(device), geometry_of(device)
    assert known is not None
    assert geometry is not None
    here, expect = FrameAddress(0, 0, last), Expectation(footprint=region(last, last, 0))
    fits = geometry.frames(here) + 1 + padding
    for count, wanted in ((fits, []), (fits + 1, ["footprint_outside"])):
        assert codes(assemble(device, [FrameRun(here, bytes(4 * known.family.frame_words * count))]), expect) == wanted


@pytest.mark.parametrize(("device", "count"), [("xc7z020", 228), ("xc7a100t", 228), ("xc7a35t", 132)])
def test_block_type_2_holds_what_vivado_writes_and_no_frame_more(device: str, count: int) -> None:
    expect = Expectation(footprint=(FrameRange(block_type=2, row=0, column_first=0, column_last=0),))
    assert codes(assemble(device, [FrameRun(FrameAddress(2, 0, 0), frames(count))]), expect) == []
    longer = assemble(device, [FrameRun(FrameAddress(2, 0, 0), frames(count + 1))])
    assert codes(longer, expect) == ["footprint_outside"]
