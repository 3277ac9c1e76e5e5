# SPDX-License-Identifier: Apache-2.0
"""`cm build init --from zypr`: the form of the paper's authors' project files, with modules of our own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import cm.schema
from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.generate.generation import load_design
from cm.design.zypr import zypr_text
from cm.simulation.rtl.design import load_rtl_design

HDL = Path(__file__).parents[2] / "rtl/hls/hdl"
SITES = ["SLICE_X29Y120:SLICE_X48Y167 CFGIO_SITE_X0Y0:CFGIO_SITE_X0Y0", "RAMB36_X3Y24:RAMB36_X5Y32"]
OTHERS = ["SLICE_X29Y60:SLICE_X48Y107 RAMB36_X3Y12:RAMB36_X5Y20"]


def project(**settings: str) -> dict[str, Any]:
    modules = {"tone_a": {"rtl": ["tone.v", "tone_control_s_axi.v", "curves/tone_curve.v"], "top_cell": "tone"}}
    region = {"pblock": SITES, "default_config": "config_a", "valid_configs": ["tone"]}
    mode = {
        "settings": settings,
        "pr_regions": {"left": region, "right": {**region, "pblock": OTHERS}, "again": {**region, "pblock": OTHERS}},
        "configs": {"config_a": {"modules": modules}},
    }
    device = {"device": "xczu3eg", "package": "-sbva484", "speed": "-1", "option": "-i"}
    return {
        "config": {"config_xilinx": {"xilinx_proxy": "ssh -D 9050"}, "config_zypr": {"clock_freq": 150}},
        "project": {"project_name": "demo", "project_owner": "someone", "project_device": device},
        "design": {"design_directory": "rtl", "design_default_mode": "mode_a", "design_mode": {"mode_a": mode}},
        "linux": {"linux_build": {}},
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for file in HDL.glob("tone*"):
        place = tmp_path / "rtl" / ("curves" if "curve" in file.name else "tone")
        place.mkdir(parents=True, exist_ok=True)
        (place / file.name).write_bytes(file.read_bytes())
    return tmp_path


def written(folder: Path, content: dict[str, Any]) -> Path:
    path = folder / "demo.json"
    path.write_text(json.dumps(content))
    (folder / "build.yaml").write_text(zypr_text(path, folder))
    return folder / "build.yaml"


def test_a_rate_that_no_divider_gives_is_written_with_the_tolerance_that_it_takes(folder: Path) -> None:
    """Theirs is 200 MHz, for which Vivado takes 187.5 of the I/O PLL: `check` would refuse it."""
    theirs = project()
    theirs["config"]["config_zypr"]["clock_freq"] = 200
    schema = written(folder, theirs)
    assert "clocks: {pl0: {rate: 200_000_000, tolerance: 7}}" in schema.read_text()
    assert main(["build", "check", str(schema)]) == 0


def test_a_project_file_becomes_a_design_without_a_line_by_hand(folder: Path) -> None:
    path = folder / "demo.json"
    path.write_text(json.dumps(project(dma="video")))
    schema = folder / "build.yaml"
    assert main(["build", "init", "--from", "zypr", str(path), "--output", str(schema)]) == 0
    assert main(["build", "generate", str(schema)]) == 0
    system = load_design(schema).system
    assert system.device == "xczu3eg"
    assert system.project.clocks["pl0"].rate == 150_000_000
    assert [region.name for region in system.regions] == ["left", "right"]
    assert {bus.dma.kind.value for region in system.regions for bus in region.streams if bus.dma} == {"axi_vdma"}
    assert {one.module.top for one in system.implementations} == {"tone"}


def test_what_is_not_taken_over_is_said(folder: Path) -> None:
    text = written(folder, project()).read_text()
    assert "Not taken over, as nothing here is the like: config_xilinx, project_owner, linux_build." in text
    assert "# the static part's: CFGIO_SITE_X0Y0:CFGIO_SITE_X0Y0" in text
    assert "# again: left out, as its sites are those of right" in text
    assert "connect: vdma" not in text


def test_registers_are_read_from_what_hls_wrote(folder: Path) -> None:
    assert "register_map: rtl/tone/tone_control_s_axi.v" in written(folder, project()).read_text()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{", "demo.json is no project file of zypr: Expecting property name"),
        ('{"config": {}}', "demo.json is no project file of zypr: it has no 'design'"),
        ("[]", "demo.json is no project file of zypr"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "demo.json"
    path.write_text(text)
    with pytest.raises(BuildError, match=why):
        zypr_text(path, tmp_path)


def test_sources_that_are_not_there_are_named(folder: Path) -> None:
    (folder / "rtl/tone/tone.v").unlink()
    with pytest.raises(BuildError, match=r"rtl holds no tone\.v"):
        written(folder, project())


def test_the_simulation_finds_a_module_of_two_regions_by_the_names_of_the_runtime_schema(folder: Path) -> None:
    design = load_rtl_design(written(folder, project()), folder / "tree")
    schema = folder / "demo.yaml"
    schema.write_text(design.schema)
    modules = cm.schema.load(schema).modules.values()
    assert {(module.region, module.name) for module in modules} == set(design.modules)
