# SPDX-License-Identifier: Apache-2.0
"""A module and the static part of another region: together, or refused at the first difference."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from xray_oracle import DATABASE, fetched_or_skipped

from cm.formats.bitstream import CrcResult, FrameAddress, FrameRun, assemble, inspect
from cm.formats.bitstream.errors import CannotRelocate
from cm.formats.bitstream.memory import frames_in
from cm.formats.bitstream.relocate import relocate
from cm.formats.xray import Database, Feature, decode, encode, to_bytes

pytestmark = pytest.mark.open
UPPER, LOWER = 0x1400, 0x401400  # a column of slices in the upper and in the lower half
SWITCH = "NE6BEG2.LOGIC_OUTS_L14"


@pytest.fixture(scope="module")
def database() -> Database:
    return Database.open("xc7z010", fetched_or_skipped().path(DATABASE))


def frames_of(database: Database, features: Iterable[tuple[str, str]]) -> dict[int, int]:
    encoded = encode(database, {Feature(*one) for one in features})
    assert not encoded.unresolved
    return encoded.frames


def partial(frames: dict[int, int], column: int = UPPER, columns: int = 1, crc: bool = True) -> bytes:
    """A bitstream of whole columns, as the flow makes it: one run."""
    addresses = [column + (more << 7) + minor for more in range(columns) for minor in range(36)]
    data = b"".join(to_bytes(frames.get(address, 0)) for address in addresses)
    row, number = (32 if column & 1 << 22 else 0), column >> 7 & 0x3FF
    return assemble("xc7z010", [FrameRun(FrameAddress(0, row, number), data + bytes(404))], crc=crc)


def told(database: Database, module: bytes, blank: dict[int, int], moves: dict[int, int]) -> str:
    with pytest.raises(CannotRelocate) as refused:
        relocate(module, moves, blank, database)
    return str(refused.value)


def test_where_the_static_part_is_the_same_the_bitstream_goes_there_and_back(database: Database) -> None:
    static = [("INT_L_X16Y60", SWITCH), ("INT_L_X16Y10", SWITCH)]
    blank = frames_of(database, static)
    module = partial(frames_of(database, [static[0], ("CLBLL_L_X16Y61", "SLICEL_X0.ALUT.INIT[5]")]), crc=False)
    there = relocate(module, {UPPER: LOWER}, blank, database)
    assert inspect(there).crc is CrcResult.ABSENT, "only what has to be is another"
    assert decode(database, frames_in(there)[1]).features == {
        Feature("INT_L_X16Y10", SWITCH),
        Feature("CLBLL_L_X16Y11", "SLICEL_X0.ALUT.INIT[5]"),
    }
    assert relocate(there, {LOWER: UPPER}, blank, database) == module


def test_what_the_static_part_has_there_stays_and_what_it_had_here_does_not_come_along(database: Database) -> None:
    blank = frames_of(database, [("INT_L_X16Y60", SWITCH), LEAF, ("INT_L_X16Y13", SWITCH)])
    own = [("CLBLL_L_X16Y61", "SLICEL_X0.ALUT.INIT[5]"), ("INT_L_X16Y70", "NN2BEG0.LOGIC_OUTS_L0")]
    module = frames_of(database, [("INT_L_X16Y60", SWITCH), LEAF, *own])
    there = relocate(partial(module), {UPPER: LOWER}, blank, database)
    wanted = [("INT_L_X16Y13", SWITCH), ("CLBLL_L_X16Y11", own[0][1]), ("INT_L_X16Y20", own[1][1])]
    assert decode(database, frames_in(there)[1]).features == {Feature(*one) for one in wanted}


def test_frames_that_follow_each_other_are_one_run_there_too_from_column_to_column(database: Database) -> None:
    moves = {UPPER: LOWER, UPPER + 0x80: LOWER + 0x80}
    blank = frames_of(database, [("INT_L_X16Y60", SWITCH), ("INT_L_X16Y13", SWITCH)])
    module = partial({address: blank.get(address, 0) for at in moves for address in range(at, at + 36)}, columns=2)
    for data in (module, relocate(module, moves, blank, database)):
        assert [(run.column, run.frames) for run in inspect(data).footprint] == [(40, 73)]


def test_a_wire_that_turns_back_at_the_edge_of_the_device_leads_out_of_another_region(database: Database) -> None:
    features = [("CLBLL_L_X16Y98", "SLICEL_X0.ALUT.INIT[5]"), ("INT_L_X16Y99", "NN2BEG0.LOGIC_OUTS_L0")]
    refused = told(database, partial(frames_of(database, features)), {}, {UPPER: LOWER})
    assert refused == "wire NN2BEG0 of INT_L_X16Y49, which the module uses, leads out of the region: to INT_L_X16Y50"


def test_a_wire_that_turns_back_only_there_has_other_ends(database: Database) -> None:
    module = partial(frames_of(database, [("INT_L_X16Y49", "NN2BEG0.LOGIC_OUTS_L0")]), LOWER)
    refused = told(database, module, {}, {LOWER: UPPER})
    assert refused == "wire NN2BEG0 of INT_L_X16Y99, which the module uses, has other ends there"


def test_columns_of_other_kinds_are_refused_even_with_as_many_frames(database: Database) -> None:
    refused = told(database, partial({}), {}, {UPPER: 0x1480})
    assert refused.startswith(
        "column kinds differ: at word 0 of frame 00001400 lies CLBLL_L, INT_L, of 00001480 CLBLM_R"
    )


def test_another_static_parts_module_is_refused(database: Database) -> None:
    blank = frames_of(database, [("INT_L_X16Y60", SWITCH)])
    assert "the bitstream was made for another one" in told(database, partial({}), blank, {UPPER: LOWER})


LUT, LINE = "SLICEL_X0.ALUT.INIT[37]", "HCLK_CK_BUFHCLK8"
LEAF, ENABLE = ("HCLK_L_X85Y78", f"HCLK_LEAF_CLK_B_TOPL0.{LINE}"), ("HCLK_L_X85Y78", f"ENABLE_BUFFER.{LINE}")


@pytest.mark.parametrize(
    ("static", "module", "reason"),
    [
        ([("INT_L_X16Y10", "SS2BEG0.SL1END0")], [("INT_L_X16Y60", "SS2BEG0.LOGIC_OUTS_L12")],
         "INT_L_X16Y10.SS2BEG0 has two drivers: INT_L_X16Y10.SS2BEG0.LOGIC_OUTS_L12 and INT_L_X16Y10.SS2BEG0.SL1END0, "
         "and 1 more"),  # the bit that both set
        ([("CLBLL_L_X16Y11", "SLICEL_X0.AFFMUX.AX")], [("CLBLL_L_X16Y61", "SLICEL_X0.AFFMUX.F7")],
         "CLBLL_L_X16Y11.SLICEL_X0.AFFMUX.AX is not there any more once both are, and 1 more"),
        ([("CLBLL_L_X16Y11", LUT)], [("CLBLL_L_X16Y61", LUT)], "bit 5 of word 22 of frame 00401421 is set by both"),
        ([LEAF], [LEAF, ("INT_L_X16Y75", "CLK_L0.GCLK_L_B6_WEST")],
         f"the module needs HCLK_L_X85Y26.{LEAF[1]}, which the static part of its old region has"),
        ([ENABLE], [ENABLE, LEAF],
         f"the module needs HCLK_L_X85Y26.{ENABLE[1]}, which the static part of its old region has"),
    ],
    ids=["drivers", "feature", "bit", "leaf", "line"],
)  # fmt: skip
def test_what_a_module_and_the_static_part_cannot_have_together_is_named(
    database: Database, static: list[tuple[str, str]], module: list[tuple[str, str]], reason: str
) -> None:
    refused = told(database, partial(frames_of(database, module)), frames_of(database, static), {UPPER: LOWER})
    assert refused == f"the module and the static part are in each other's way there: {reason}"


@pytest.mark.parametrize(
    ("row", "used", "top", "bottom", "reason"),
    [
        ("X85", ENABLE[1], "MUX_OUT_R8.CLK_HROW_R_CK_GCLK0", "MUX_OUT_R8.CLK_HROW_R_CK_GCLK0", None),
        ("X85", ENABLE[1], "MUX_OUT_R9.CLK_HROW_R_CK_GCLK0", "MUX_OUT_R9.CLK_HROW_R_CK_GCLK1", None),
        ("X85", ENABLE[1], "MUX_OUT_R8.CLK_HROW_R_CK_GCLK0", "MUX_OUT_R8.CLK_HROW_R_CK_GCLK1", "line 8 {0} {1}"),
        ("X46", ENABLE[1], "MUX_OUT_L8.CLK_HROW_R_CK_GCLK0", "MUX_OUT_R8.CLK_HROW_R_CK_GCLK0", "line 8 {0} nothing"),
        ("X85", ENABLE[1], "BUFHCE_X1Y8.IN_USE", "BUFHCE_X0Y8.IN_USE", "line 8 {0} nothing"),
        ("X85", "HCLK_LEAF_CLK_B_TOPL0.HCLK_CK_OUTIN_L0", "MUX_OUT_R11.CLK_HROW_R_CK_GCLK0",
         "MUX_OUT_R11.CLK_HROW_R_CK_GCLK1", "line 11 {0} {1}"),  # it may have to do with any of the lines
    ],
    ids=["same", "another line", "right", "left", "buffer", "any line"],
)  # fmt: skip
def test_a_clock_row_that_is_driven_by_another_clock_is_refused(
    database: Database, row: str, used: str, top: str, bottom: str, reason: str | None
) -> None:
    drivers = [("BUFHCE." if one.startswith("BUFHCE") else "CLK_HROW_CK_") + one for one in (top, bottom)]
    blank = frames_of(database, zip(("CLK_HROW_TOP_R_X82Y78", "CLK_HROW_BOT_R_X82Y26"), drivers, strict=True))
    column = {"X85": UPPER, "X46": 0xC00}[row]
    module = partial(frames_of(database, [(f"HCLK_L_{row}Y78", used)]), column)
    moves = {column: column | 1 << 22, 0x800180: 0xC00180}
    if reason is None:
        assert relocate(module, moves, blank, database)
    else:
        line, here, there = reason.format(*drivers).rsplit(" ", 2)
        of = f"of the clock row at HCLK_L_{row}Y26 is driven by {there}, where the module comes from by {here}"
        assert told(database, module, blank, moves) == f"{line} {of}"
