# SPDX-License-Identifier: Apache-2.0
"""What lies in frames: columns, tiles and bits, without a database, and their picture."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from bitstream_support import HERE, frames

from cm.formats.bitstream import Container, Device, Family, FrameAddress, FrameRun, assemble, convert
from cm.formats.bitstream.errors import BadPacket, CrcMismatch, UnknownDevice
from cm.formats.bitstream.memory import frames_in
from cm.formats.xray.drawing import svg
from cm.formats.xray.fabric import ROWS, fabric, row_of
from cm.formats.xray.frames import ECC_MASK

COLUMN = 0x1480  # of an XC7Z020: a column of slices


def test_words_of_a_frame_are_rows_of_tiles_with_the_clock_row_between() -> None:
    assert [row_of(word) for word in (0, 1, 2, 49, 50, 51, 100)] == [0, 0, 1, 24, None, 25, 49]


def test_bits_are_counted_by_frame_and_by_row_of_tiles_without_the_checksum() -> None:
    switches = 1 << 64 | 1 << 3231 | ECC_MASK | 1 << 32 * 50 + 13
    (column,) = fabric({COLUMN: switches, COLUMN + 1: 0, COLUMN + 30: 3})
    assert column.bits == (3, 0, 2)
    assert (column.switches[1], column.switches[49], sum(column.switches)) == (1, 1, 2)
    assert (column.logic[0], sum(column.logic), column.clock) == (2, 2, 1)


def test_columns_have_their_place_and_the_kind_that_their_frames_allow() -> None:
    found = fabric({COLUMN + minor: 0 for minor in range(36)} | {0x800100 + minor: 1 for minor in range(128)})
    assert [(c.block_type, c.row, c.number, c.kind) for c in found] == [(0, 0, 41, "CLB"), (1, 0, 2, "contents")]
    assert found[1].logic[0] == 128  # none of it is switches


def test_a_bitstream_that_is_damaged_or_of_another_family_has_no_frames() -> None:
    good = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 26), frames(3))])
    with pytest.raises(CrcMismatch):
        frames_in(good.replace(frames(3)[:404], frames(3)[1:405]))
    with pytest.raises(BadPacket):
        frames_in(assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 127), frames(2))]))
    ultrascale = assemble("xczu3eg", [FrameRun(FrameAddress(0, 0, 26), bytes(372 * 3))])
    unmeasured = assemble("xc7k355t", [FrameRun(HERE, frames(1))])
    unlisted = assemble(Device("xczu28dr", 0x04A11093, Family.ULTRASCALE_PLUS), [FrameRun(HERE, bytes(372))])
    for data, told in (
        (ultrascale, "xczu3eg: the frames of its columns are not known"),
        (unmeasured, "xc7k355t: the frames of its columns are not known"),
        (unlisted, "xczu28dr: its frames are not known"),
        (convert(unlisted, Container.BIN_SWAPPED), "IDCODE 04A11093: its frames are not known"),
    ):
        with pytest.raises(UnknownDevice, match=f"^{told}$"):
            frames_in(data)


def test_the_picture_shows_each_frame_and_what_is_wrong_in_red() -> None:
    columns = fabric({COLUMN + minor: 1 << 64 * 7 for minor in range(36)})
    picture = ET.fromstring(svg(columns, "Region <A>", {COLUMN + 4: [14], COLUMN + 5: []}))
    titles = {node.text or "": node for node in picture.iter("{http://www.w3.org/2000/svg}title")}
    assert "Region <A>" in titles
    told = [text for text in titles if text.startswith("frame ")]
    assert len(told) == 36
    assert {text[6:14] for text in told if text.endswith("wrong")} == {"00001484", "00001485"}
    (row,) = (text for text in titles if text.startswith("row 7:"))
    assert row.endswith("wrong in frame 00001484")


def test_a_picture_of_nothing_is_a_picture() -> None:
    picture = ET.fromstring(svg(fabric({}), "none"))
    assert float(picture.attrib["height"]) > 0
    assert len(fabric({COLUMN: 0})[0].logic) == ROWS
