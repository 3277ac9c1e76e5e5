# SPDX-License-Identifier: Apache-2.0
"""The open flow's static part as it goes to yosys, on a model of the processing system's ports, with a module in it."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from build_support import EXAMPLES, copy_examples, generated
from conftest import HERE, needs
from simulation import simulate

from cm.design.openflow.flow import OWN_RTL
from cm.design.openflow.netlists import TOP, open_system, open_top
from cm.design.openflow.rules import check_open
from cm.design.render import Renderer

pytestmark = pytest.mark.timeout(600)


@needs("verilator")
@needs("yosys")
@pytest.mark.parametrize("name", ["open_camera", "pair"])
def test_the_generated_top_is_clean_under_lint(name: str, tmp_path: Path) -> None:
    """With an engine of both directions, and with four of one each at two ports to memory."""
    folder = copy_examples(tmp_path)
    for source in (EXAMPLES / "open_camera", HERE.parent / "open/pair"):
        shutil.copytree(source, folder / source.name)
    schema = folder / name / "build.yaml"
    schema.write_text(re.sub(r"(._axis): {connect: none}", r"\1: {connect: dma}", schema.read_text()))
    design, out = generated(folder, name)
    assert check_open(design.system) == []
    renderer = Renderer(design.project.folder, out, "Generated for a test.")
    made = tmp_path / "made"
    made.mkdir()
    for net in (open_top(design.system), open_system(design.system)):
        (made / f"{net.name}.v").write_text(renderer.render("module.v.j2", {"net": net}))
    (made / "PS7.v").write_text(ps7())
    (made / "BUFG.v").write_text("module BUFG (input wire I, output wire O);\n    assign O = I;\nendmodule\n")
    folders = [made, out / "hdl", out / "hdl/lib", OWN_RTL[0].parent, HERE / "models"]
    words = [str(word) for folder in folders for word in ("-y", folder)]
    command = [
        "verilator",
        "--lint-only",
        "-Wall",
        "-Wno-PINMISSING",
        "--top-module",
        TOP,
        *words,
        str(made / f"{TOP}.v"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert not done.stderr
    assert done.returncode == 0


def ps7() -> str:
    """The cell as yosys' library of the device's cells has it."""
    program = shutil.which("yosys")
    assert program is not None
    library = (Path(program).resolve().parents[1] / "share/yosys/xilinx/cells_xtra.v").read_text()
    found = re.search(r"^module PS7\b.*?^endmodule$", library, re.DOTALL | re.MULTILINE)
    assert found is not None
    pins = re.findall(r"^ +((?:in|out)put) (\[\d+:0\] )?(\w+);", found[0], re.MULTILINE)
    listed = ",\n".join(f"    {direction} wire {width}{name}" for direction, width, name in pins)
    off = "/* verilator lint_off UNDRIVEN */\n/* verilator lint_off UNUSEDSIGNAL */\n"
    return f"{off}module PS7 (\n{listed}\n);\nendmodule\n"


@needs("iverilog")
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
