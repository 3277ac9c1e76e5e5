# SPDX-License-Identifier: Apache-2.0
"""The open flow's static part as it goes to yosys, on a model of the processing system's ports, with a module in it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from build_support import EXAMPLES, copy_examples, generated
from conftest import HERE, needs
from simulation import simulate

from cm.build.openflow.flow import OWN_RTL
from cm.build.openflow.netlists import TOP, open_system, open_top
from cm.build.render import Renderer

pytestmark = [needs("iverilog"), pytest.mark.timeout(600)]


def test_the_processing_system_streams_pictures_through_a_region(tmp_path: Path) -> None:
    folder = copy_examples(tmp_path)
    shutil.copytree(EXAMPLES / "open_camera", folder / "open_camera")
    schema = folder / "open_camera/build.yaml"
    schema.write_text(
        schema.read_text().replace("top: camera_edge\n", "top: camera_edge\n    parameters: {LINE: 16}\n")
    )
    design, out = generated(folder, "open_camera")
    renderer = Renderer(design.project.folder, out, "Generated for a test.")
    for net in (open_top(design.system), open_system(design.system)):
        (out / f"{net.name}.v").write_text(renderer.render("module.v.j2", {"net": net}))
    one = design.system.implementation("edge", "prr0")
    sources = [out / f"{TOP}.v", out / "cm_open_system.v", out / "hdl/cm_static.v", *OWN_RTL]
    sources += [*sorted((out / "hdl/lib").glob("*.v")), HERE / "tb/ps7.v", *sorted((HERE / "models").glob("*.v"))]
    sources += [out / "wrappers/edge/cm_region_prr0.v", *one.module.sources]
    made = tmp_path / "simulation"
    made.mkdir()
    assert len(simulate(TOP, sources, "cocotb_open_system", made, CM_IDENTITY=str(one.identity))) == 2
