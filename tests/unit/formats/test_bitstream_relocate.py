# SPDX-License-Identifier: Apache-2.0
"""Bitstreams at other frame addresses, without a database: what is rewritten, and what is refused."""

from __future__ import annotations

import hashlib

import pytest
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
    device_by_name,
    inspect,
)
from cm.formats.bitstream.errors import CannotRelocate
from cm.formats.bitstream.memory import frames_in
from cm.formats.bitstream.relocate import column_moves, moved, readdressed
from cm.schema.model import FrameRange

DEVICE = device_by_name("xc7z010")
UPPER = (FrameRange(0, 0, 40, 44), FrameRange(1, 0, 3, 3))
LOWER = (FrameRange(0, 32, 40, 44), FrameRange(1, 32, 3, 3))
WIDTHS = {40: 36, 41: 36, 42: 28, 43: 36, 44: 36}


def moves(source: tuple[FrameRange, ...] = UPPER, target: tuple[FrameRange, ...] = LOWER) -> dict[int, int]:
    assert DEVICE is not None
    return dict(column_moves(DEVICE, source, target))


@st.composite
def partials(draw: st.DrawFn) -> bytes:
    """A partial bitstream of the upper region: runs within it, of any length, in any order, and shared frames."""
    runs: list[FrameRun | SharedFrame] = []
    for column in draw(st.lists(st.sampled_from(sorted(WIDTHS)), min_size=1, max_size=4)):
        minor = draw(st.integers(0, WIDTHS[column] - 1))
        left = sum(width for at, width in WIDTHS.items() if at >= column) - minor
        address = FrameAddress(0, 0, column, minor)
        data = hashlib.shake_128(bytes([column, minor])).digest(404 * (draw(st.integers(1, left)) + 1))
        runs.append(SharedFrame(data[:404], (address,)) if draw(st.booleans()) else FrameRun(address, data))
    made = assemble("xc7z010", runs, crc=draw(st.booleans()), sections=draw(st.integers(1, len(runs))))
    form = draw(st.sampled_from([Container.BIT, Container.BIN_SWAPPED, Container.BIN_STRAIGHT]))
    return convert(made, form, None)


@given(partials())
def test_there_and_back_gives_the_same_bytes_and_between_only_the_addresses_differ(data: bytes) -> None:
    there = readdressed(data, moves())
    assert frames_in(there)[1] == moved(frames_in(data)[1], moves())
    before, after = inspect(data), inspect(there)
    assert (after.container, after.header, after.crc) == (before.container, before.header, before.crc)
    assert after.crc is not CrcResult.WRONG
    assert len(there) == len(data)
    assert readdressed(there, moves(LOWER, UPPER)) == data


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ((FrameRange(0, 32, 40, 43), LOWER[1]), r"columns 40-44 of row 0 .* are 5 columns, .* of row 32 .* are 4"),
        ((FrameRange(0, 32, 41, 45), LOWER[1]), "column 41 of row 0 has 36 frames, column 42 of row 32 has 28"),
        ((FrameRange(0, 1, 40, 44), LOWER[1]), "column 40 of row 0 has 36 frames, column 40 of row 1 has 0"),
        (LOWER[:1], "the regions have 0, 1 and 0 rows of columns"),
        ((), "the regions have 0, 1 and no rows of columns"),
    ],
)
def test_another_sequence_of_columns_is_refused_at_the_first_difference(
    target: tuple[FrameRange, ...], told: str
) -> None:
    with pytest.raises(CannotRelocate, match=told):
        moves(UPPER, target)
    nowhere = FrameRange(0, 1, 40, 44), FrameRange(0, 33, 40, 44)
    with pytest.raises(CannotRelocate, match="column 40 of row 1 has 0 frames, column 40 of row 33 has 0"):
        moves(nowhere[:1], nowhere[1:])


def test_rows_of_a_region_keep_their_order_across_the_middle() -> None:
    device = device_by_name("xc7a50t")
    assert device is not None
    upper, lower = (FrameRange(0, 0, 20, 20), FrameRange(0, 1, 20, 20)), (FrameRange(0, 32, 20, 20),)
    assert column_moves(device, upper, (*lower, *upper[:1])) == {0xA00: 0x400A00, 0x20A00: 0xA00}
    zynq = device_by_name("xc7z020")
    assert zynq is not None
    bottom = (FrameRange(0, 33, 30, 30), FrameRange(0, 32, 30, 30))
    assert column_moves(zynq, (FrameRange(0, 32, 30, 30), FrameRange(0, 0, 30, 30)), bottom) == {
        0x400F00: 0x420F00,
        0xF00: 0x400F00,
    }


def test_only_devices_whose_columns_are_known_are_moved_within() -> None:
    device = device_by_name("xczu3eg")
    assert device is not None
    with pytest.raises(CannotRelocate, match="xczu3eg: only 7-series devices"):
        column_moves(device, UPPER, LOWER)


def test_only_what_is_written_to_far_is_a_frame_address() -> None:
    here, there = (assemble("xc7z010", [FrameRun(FrameAddress(0, 0, at), bytes(808))]) for at in (8, 10))
    assert readdressed(here, {0x400: 0x500}) == there  # 0x400 is also what is written to CTL0


def test_frames_that_are_not_of_the_region_are_named() -> None:
    data = assemble("xc7z010", [FrameRun(FrameAddress(0, 0, 39), bytes(808))])
    with pytest.raises(CannotRelocate, match="frame 00001380 is not of the region"):
        readdressed(data, moves())


def test_a_run_that_ends_a_row_is_not_moved_to_where_none_ends() -> None:
    """Behind a row two frames are dropped; in the middle of one they would be the next column's."""
    data = assemble("xc7z010", [FrameRun(FrameAddress(0, 0, 55, 40), bytes(404 * 5))])
    with pytest.raises(
        CannotRelocate, match=r"^a run of frames goes over the end of its row, and would not do so in the other region$"
    ):
        readdressed(data, {0x1B80: 0})
