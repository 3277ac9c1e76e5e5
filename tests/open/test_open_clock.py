# SPDX-License-Identifier: Apache-2.0
"""Which ways of the clock a module may take: those that the static part switches on, in frames that are not its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from cm.design.generate.generation import load_design
from cm.design.openflow.job import other_lanes
from cm.design.openflow.layout import Layout, layouts
from cm.design.openflow.tools import Tools
from cm.formats.xray import Database, Feature, Wires

SCHEMA = """\
project: {name: beside, board: zybo-z7-20}
clocks: {fclk0: {rate: 50_000_000}}
regions:
  left: {pblock: [SLICE_X102Y0:SLICE_X107Y49], clock: fclk0, loader: fpga_manager}
  right: {pblock: [SLICE_X108Y0:SLICE_X113Y49], clock: fclk0, loader: fpga_manager}
modules:
  one: {sources: [one.v], regions: [left]}
  two: {sources: [one.v], top: one, regions: [right]}
"""
MODULE = "module one (input wire aclk, input wire aresetn, input wire [7:0] s_axis_tdata, input wire s_axis_tvalid);\n"


@pytest.fixture
def places(tools: Tools, tmp_path: Path) -> tuple[Database, dict[str, Layout]]:
    (tmp_path / "build.yaml").write_text(SCHEMA)
    (tmp_path / "one.v").write_text(f"{MODULE}endmodule\n")
    system = load_design(tmp_path / "build.yaml").system
    database = Database.open(system.project.part, tools.database)
    return database, layouts(system, database)


def test_a_leaf_between_two_regions_belongs_to_one_of_them(places: tuple[Database, dict[str, Layout]]) -> None:
    """A flip-flop of the left one's last column can be reached through it; the right one's frames switch it on."""
    database, regions = places
    between = database.tiles["HCLK_R_X171Y26"]
    assert between.name in regions["right"].tiles
    leaf = f"X{between.x}Y{between.y}/HCLK_LEAF_CLK_B_TOP0"
    wires = Wires(database)
    assert leaf in other_lanes(database, wires, regions["left"], frozenset())
    assert leaf not in other_lanes(database, wires, regions["right"], frozenset())


def test_a_leaf_that_the_static_part_switches_on_is_the_modules_too(
    places: tuple[Database, dict[str, Layout]],
) -> None:
    database, regions = places
    wires = Wires(database)
    before = other_lanes(database, wires, regions["left"], frozenset())
    on = Feature("HCLK_R_X171Y26", "HCLK_LEAF_CLK_B_TOP0.HCLK_CK_BUFHCLK0")
    between = database.tiles[on.tile]
    assert before - other_lanes(database, wires, regions["left"], {on}) == {
        f"X{between.x}Y{between.y}/HCLK_LEAF_CLK_B_TOP0"
    }
