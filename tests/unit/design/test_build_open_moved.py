# SPDX-License-Identifier: Apache-2.0
"""A relocatable module is made once by the open flow; regions that do not fit are refused before the tools run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from build_support import AXIL_MODULE, project

from cm.design.errors import BuildError
from cm.design.generate.generation import load_design
from cm.design.openflow.layout import Layout
from cm.design.openflow.relocatable_modules import check_moved, moved_image, moves_of
from cm.design.openflow.rules import check_open
from cm.design.plan.system import System
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import runtime_config
from cm.formats.bitstream import FrameAddress, FrameRun, assemble
from cm.formats.bitstream.errors import CannotRelocate
from cm.formats.bitstream.geometry import encode_far
from cm.formats.bitstream.idcodes import Family
from cm.formats.xray import Database

SCHEMA = """\
project: {name: small, board: zybo-z7-20}
clocks: {fclk0: {rate: 50_000_000}}
regions:
  left: {pblock: [SLICE_X26Y50:SLICE_X31Y99], clock: fclk0, loader: fpga_manager}
  right: {pblock: [SLICE_X26Y0:SLICE_X31Y49], clock: fclk0, loader: fpga_manager}
modules:
  one: {sources: [one.v], regions: [left, right], relocatable: true}
  two: {sources: [two.v], regions: [right]}
modes:
  first: {modules: {left: one, right: one}}
  second: {modules: {left: one, right: two}}
"""
TWO = AXIL_MODULE.replace("module one", "module two")
MORE = TWO.replace("resetn,\n", "resetn,\n    input  wire [2:0]  more,\n", 1)
Load = Callable[..., System]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def loaded(text: str = SCHEMA, two: str = TWO) -> System:
        return load_design(project(tmp_path, text, one=AXIL_MODULE, two=two)).system

    return loaded


@pytest.fixture
def no_database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_XRAY_DATABASE", str(tmp_path / "none"))


def test_it_is_placed_and_routed_for_its_first_region_alone(load: Load) -> None:
    system = load()
    assert [one.name for one in system.placed] == ["one_left", "two"]
    assert [(origin.name, one.name) for origin, one in system.moved] == [("one_left", "one_right")]
    turned = load(SCHEMA.replace("[left, right]", "[right, left]"))
    assert [(origin.name, one.name) for origin, one in turned.moved] == [("one_right", "one_left")]


def test_it_answers_everywhere_as_in_its_first_region(load: Load) -> None:
    left, right = (load().implementation("one", region).identity for region in ("left", "right"))
    assert left == right


def test_another_module_is_placed_and_routed_for_each_region(load: Load) -> None:
    system = load(SCHEMA.replace(", relocatable: true", ""))
    assert system.placed == system.implementations
    assert not system.moved
    assert len({one.identity for one in system.implementations}) == len(system.implementations) == 3


def test_in_the_runtime_schema_each_region_has_a_module_of_its_own(load: Load) -> None:
    modules = runtime_config(load(), Answers()).modules
    told = {name: (module.region, str(module.bitstream)) for name, module in modules.items()}
    assert told == {
        "one_left": ("left", "one_left.bin"),
        "one_right": ("right", "one_right.bin"),
        "two": ("right", "two.bin"),
    }


@pytest.mark.usefixtures("no_database")
def test_without_the_database_check_says_that_shapes_are_not_known(load: Load) -> None:
    system = load()
    assert check_open(system) == []
    (note,) = check_moved(system)
    text = note.text(system.project.source)
    assert not note.error
    assert "modules.one.regions[1]: one_right.bit is made of one_left.bit" in text
    assert "whether right has the shape of left is not known" in text
    assert "cm build tools --fetch" in text


@pytest.mark.usefixtures("no_database")
def test_a_boundary_that_has_more_is_refused_with_the_first_port(load: Load) -> None:
    system = load(two=MORE)
    (finding,) = check_moved(system)
    assert finding.error
    text = finding.text(system.project.source)
    assert (
        "modules.one.regions[1]: one cannot be moved from left to right: "
        "left has no more at its boundary, right has input wire [2:0] more; "
    ) in text
    assert "(leave the region out" in text


def place(system: System, region: str, row: int, *columns: int) -> Layout:
    """A region of whole columns, of a tile each."""
    bases = [encode_far(FrameAddress(0, row, column), Family.SERIES7) for column in columns]
    tiles = {f"{region}{x}": SimpleNamespace(kind="CLBLL_L", x=x, y=0) for x in columns}
    return Layout(system.region(region), cast(Any, tiles), frozenset(base >> 7 for base in bases), (), ())


def moves(system: System, *right: int, left: tuple[int, ...] = (2, 3, 4), row: int = 0) -> dict[int, int]:
    places = {"left": place(system, "left", 0, *left), "right": place(system, "right", row, *right)}
    return dict(moves_of(system, places, cast(Database, SimpleNamespace(tiles={})))["one_right"])


def test_columns_of_the_same_kinds_become_each_other(load: Load) -> None:
    found = moves(load(), 2, 3, 4, row=32)
    assert found == {column << 7: 1 << 22 | column << 7 for column in (2, 3, 4)}


@pytest.mark.parametrize(
    ("left", "right", "told"),
    [
        ((2, 3, 4), (4, 5, 6), "column kinds differ: column 4 of row 0 has 36 frames, column 6 of row 0 has 28"),
        ((2, 3, 4), (2, 3), "are 3 columns, columns 2-3 of row 0 (block type 0) are 2"),
        ((2, 3, 4), (2, 4, 5), "the regions have 0 and 0, 0 rows of columns"),
        ((2, 4), (2, 5), "the columns are the same, but not as far from each other"),
    ],
)
def test_a_region_of_another_shape_is_refused_with_the_first_difference(
    load: Load, left: tuple[int, ...], right: tuple[int, ...], told: str
) -> None:
    with pytest.raises(BuildError) as refused:
        moves(load(), *right, left=left)
    text = str(refused.value)
    assert "build.yaml:7:" in text
    assert "modules.one.regions[1]: one cannot be moved from left to right: " in text
    assert told in text


def test_a_bitstream_that_cannot_be_moved_is_refused_with_both_regions_and_what_to_do(load: Load) -> None:
    ((origin, one),) = load().moved
    made = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 2), bytes(404 * 37))])
    with pytest.raises(CannotRelocate) as refused:
        moved_image(origin, one, made, {}, {}, cast(Database, SimpleNamespace(tiles={})))
    text = str(refused.value)
    assert text.startswith("one cannot be moved from left to right: frame 00000100 is not of the region")
    assert "another --seed may help" in text
