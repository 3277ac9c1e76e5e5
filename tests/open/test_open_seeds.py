# SPDX-License-Identifier: Apache-2.0
"""Which seeds the open flow tries, of modules and of the static part: with stand-ins for yosys and nextpnr."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import EXAMPLES

from cm.design.errors import StepFailed
from cm.design.generate.generation import generate, load_design, output_folder
from cm.design.openflow.flow import OpenFlow
from cm.design.openflow.placement_attempt import Settings, Unroutable
from cm.design.openflow.tools import Tool, Tools

ARC = "Failed to route arc 0 of net 'x', from X1Y1/A to X2Y2/B."
PLACE = "Unable to place cell 'x', no BELs remaining to implement cell type 'DSP48E1'"
Run = Callable[..., tuple[list[str], list[str]]]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    for name in ("camera", "open_camera"):
        shutil.copytree(EXAMPLES / name, tmp_path / name)
    return tmp_path / "open_camera"


@pytest.fixture
def run(project: Path, tools: Tools) -> Run:
    """Runs the flow; returns the names of its steps and what it said."""

    def run_it(**errors: list[tuple[list[int], str]]) -> tuple[list[str], list[str]]:
        said: list[str] = []
        design = load_design(project / "build.yaml")
        out = output_folder(design.project, None)
        generate(design, out)
        environment = (("CM_STAND_IN", json.dumps(errors)),)
        program = str(Path(__file__).with_name("stand_in.py"))
        stand_ins = (Tool(name, (sys.executable, program, name), environment) for name in ("yosys", "nextpnr"))
        flow = OpenFlow(design.system, out, Tools(*stand_ins, tools.database), said.append, Settings(jobs=1))
        return flow.run(), said

    return run_it


def placed(names: list[str]) -> list[str]:
    return [name.removeprefix("place_") for name in names if name.startswith("place_")]


def test_where_a_module_cannot_be_routed_another_static_part_is_tried_and_remembered(run: Run, project: Path) -> None:
    names, said = run(edge=[([1, 2, 3, 4], ARC)])
    assert placed(names) == ["static", "default", "colorise", "static", "default", "edge", "colorise"]
    assert (
        "module edge could not be placed and routed against the static part of seed 1: another static part, from seed 5"
    ) in said
    assert f"edge: another seed, because of ERROR: {ARC}" in said
    names, said = run()  # it could be routed now, which is not asked
    assert placed(names) == []
    # Changed, it is tried against the first one again: the same sources give the same bits, whatever was built before
    netlist = project / "build/open/edge.json"
    netlist.write_text(json.dumps(json.loads(netlist.read_text()) | {"creator": "another"}))
    names, said = run()
    assert placed(names) == ["edge"]
    assert "place_edge: place and route of module edge by nextpnr, from seed 1" in said


def test_after_three_static_parts_the_flow_ends_with_what_was_wrong(run: Run, project: Path) -> None:
    with pytest.raises(Unroutable, match=r"module edge could not be(?s:.*)seed 12(?s:.*)Failed") as told:
        run(edge=[(list(range(1, 13)), ARC)])
    assert "the same happened with every static part, of seeds 1, 5, 9" in str(told.value)
    assert not list((project / "build/bitstreams").glob("*.bit"))


def test_another_static_part_is_not_tried_for_errors_that_it_cannot_cure(run: Run) -> None:
    with pytest.raises(StepFailed, match="no BELs remaining") as told:
        run(edge=[([1, 2, 3, 4], PLACE)], colorise=[([1, 2, 3, 4], ARC)])
    assert not isinstance(told.value, Unroutable)
