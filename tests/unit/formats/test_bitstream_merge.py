# SPDX-License-Identifier: Apache-2.0
"""A module and the static part of another region: together, or refused at the first difference."""

from __future__ import annotations

import os
from collections.abc import Iterable

import pytest
from xray_oracle import DATABASE

from cm.design.debian_packages import PackagesUnavailable, fetch
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
    if os.environ.get("CM_OFFLINE"):
        pytest.skip("CM_OFFLINE: prjxray is not fetched")
    try:
        return Database.open("xc7z010", fetch(["prjxray", "prjxray-database"]).path(DATABASE))
    except (PackagesUnavailable, OSError) as problem:
        pytest.skip(f"prjxray cannot be fetched: {problem}")


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
    blank = frames_of(database, [("INT_L_X16Y60", SWITCH), ("INT_L_X16Y13", SWITCH)])
    module = frames_of(database, [("INT_L_X16Y60", SWITCH), ("CLBLL_L_X16Y61", "SLICEL_X0.ALUT.INIT[5]")])
    there = relocate(partial(module), {UPPER: LOWER}, blank, database)
    assert decode(database, frames_in(there)[1]).features == {
        Feature("INT_L_X16Y13", SWITCH),
        Feature("CLBLL_L_X16Y11", "SLICEL_X0.ALUT.INIT[5]"),
    }


def test_frames_that_follow_each_other_are_one_run_there_too_from_column_to_column(database: Database) -> None:
    moves = {UPPER: LOWER, UPPER + 0x80: LOWER + 0x80}
    blank = frames_of(database, [("INT_L_X16Y60", SWITCH), ("INT_L_X16Y13", SWITCH)])
    module = partial({address: blank.get(address, 0) for at in moves for address in range(at, at + 36)}, columns=2)
    for data in (module, relocate(module, moves, blank, database)):
        assert [(run.column, run.frames) for run in inspect(data).footprint] == [(40, 73)]


def test_a_wire_that_both_drive_is_named(database: Database) -> None:
    blank = frames_of(database, [("INT_L_X16Y10", "SS2BEG0.SL1END0")])
    module = partial(frames_of(database, [("INT_L_X16Y60", "SS2BEG0.LOGIC_OUTS_L12")]))
    refused = told(database, module, blank, {UPPER: LOWER})
    assert "INT_L_X16Y10.SS2BEG0 has two drivers" in refused
    assert refused.endswith("SL1END0, and 1 more"), "the bit that both set, which is the other reason"


def test_a_wire_that_turns_back_at_the_edge_of_the_device_leads_out_of_another_region(database: Database) -> None:
    module = partial(frames_of(database, [("INT_L_X16Y99", "NN2BEG0.LOGIC_OUTS_L0")]))
    refused = told(database, module, {}, {UPPER: LOWER})
    assert "wire NN2BEG0 of INT_L_X16Y49, which the module uses, leads out of the region: to INT_L_X16Y5" in refused


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


def test_a_clock_row_that_is_driven_by_another_clock_is_refused(database: Database) -> None:
    spine = {"CLK_HROW_TOP_R_X82Y78": 0, "CLK_HROW_BOT_R_X82Y26": 1}
    lines = [(tile, f"CLK_HROW_CK_MUX_OUT_R8.CLK_HROW_R_CK_GCLK{clock}") for tile, clock in spine.items()]
    module = partial(frames_of(database, [("HCLK_L_X85Y78", "ENABLE_BUFFER.HCLK_CK_BUFHCLK8")]))
    refused = told(database, module, frames_of(database, lines), {UPPER: LOWER})
    assert "line 8 of the clock row at HCLK_L_X85Y26 is driven by CLK_HROW_CK_MUX_OUT_R8.CLK_HROW_R_CK_GCLK1" in refused
    same = frames_of(database, [(tile, "CLK_HROW_CK_MUX_OUT_R8.CLK_HROW_R_CK_GCLK0") for tile in spine])
    assert relocate(module, {UPPER: LOWER}, same, database)


def test_a_leaf_of_the_clock_that_the_old_static_part_had_is_missed(database: Database) -> None:
    leaf = ("HCLK_L_X85Y78", "HCLK_LEAF_CLK_B_TOPL0.HCLK_CK_BUFHCLK8")
    from_leaf = ("INT_L_X16Y75", "CLK_L0.GCLK_L_B6_WEST")
    blank = frames_of(database, [leaf])
    module = partial(frames_of(database, [leaf, from_leaf]))
    refused = told(database, module, blank, {UPPER: LOWER})
    missed = "HCLK_L_X85Y26.HCLK_LEAF_CLK_B_TOPL0.HCLK_CK_BUFHCLK8, which the static part of its old region has"
    assert refused == f"the module and the static part are in each other's way there: the module needs {missed}"
