# SPDX-License-Identifier: Apache-2.0
"""The generated static part with a wrapper in its region, simulated: the camera example at 16 pixels a line."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import copy_examples, generated
from conftest import HERE, needs
from simulation import simulate

from cm.design.generate.generation import Design
from cm.schema import load

pytestmark = [needs("iverilog"), pytest.mark.timeout(600)]
MODELS = sorted((HERE / "models").glob("*.v"))


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> tuple[Design, Path]:
    folder = copy_examples(tmp_path_factory.mktemp("camera"))
    schema = folder / "camera/build.yaml"
    text = schema.read_text()
    schema.write_text(text.replace("    top: camera_edge\n", "    top: camera_edge\n    parameters: {LINE: 16}\n"))
    return generated(folder, "camera")


def static_sources(out: Path) -> list[Path]:
    return [out / "hdl/cm_static.v", *sorted((out / "hdl/lib").glob("*.v")), *MODELS]


@pytest.mark.parametrize("module", ["default", "edge", "colorise"])
def test_a_module_works_in_its_region(module: str, camera: tuple[Design, Path], tmp_path: Path) -> None:
    design, out = camera
    one = design.system.implementation(module, "prr0")
    sources = [*static_sources(out), out / f"wrappers/{module}/cm_region_prr0.v", *one.module.sources]
    static = load(out / "config/camera.yaml").static
    assert static is not None
    environment = {"CM_MODULE": module, "CM_IDENTITY": str(one.identity), "CM_STATIC_ID": str(static.identity)}
    ran = simulate("cm_static", sources, "cocotb_static_part", tmp_path, **environment)
    assert len(ran) == (11 if module == "edge" else 10)


def test_garbage_of_a_region_is_kept_from_the_static_part(camera: tuple[Design, Path], tmp_path: Path) -> None:
    design, out = camera
    garbage = tmp_path / "garbage.v"
    garbage.write_text(garbage_module(design))
    assert len(simulate("cm_static", [*static_sources(out), garbage], "cocotb_garbage", tmp_path)) == 3


def garbage_module(design: Design) -> str:
    """A region that drives all its outputs from a shift register, heeding neither reset nor protocol."""
    boundary = design.system.regions[0].boundary
    clock = next(port.name for port in boundary.ports if port.role.value == "clock")
    ports, assigns = ["output wire [31:0] cm_identity"], ["    assign cm_identity = noise[31:0];"]
    for index, port in enumerate(boundary.ports):
        bits = f"[{port.width - 1}:0] " if port.width > 1 else ""
        ports.append(f"{'input' if port.direction.value == 'in' else 'output'} wire {bits}{port.name}")
        if port.direction.value == "out":
            assigns.append(f"    assign {port.name} = noise[{index}+:{port.width}];")
    header = (
        f"module cm_region_prr0 (\n    {', '.join(ports)}\n);\n    reg [127:0] noise = 128'h1234_5678_9ABC_DEF0_0F1E;\n"
    )
    bit = "noise[127] ^ noise[125] ^ noise[100] ^ noise[98]"
    shift = f"    always @(posedge {clock}) noise <= {{noise[126:0], {bit}}};\n"
    return f"`timescale 1ns / 1ps\n{header}{shift}" + "\n".join(assigns) + "\nendmodule\n"


@pytest.mark.parametrize("second", ["gain", "invert"])
def test_two_regions_on_two_clocks(second: str, tmp_path: Path) -> None:
    examples = tmp_path / "examples"
    examples.mkdir()
    design, out = generated(copy_examples(examples), "two_regions")
    chosen = [design.system.implementation("edge", "filter"), design.system.implementation(second, "correction")]
    wrappers = [out / f"wrappers/{one.name}/{one.region.module}.v" for one in chosen]
    sources = [*static_sources(out), *wrappers, *(path for one in chosen for path in one.module.sources)]
    ids = {"CM_FIRST_ID": str(chosen[0].identity), "CM_SECOND_ID": str(chosen[1].identity), "CM_SECOND": second}
    assert len(simulate("cm_static", sources, "cocotb_two_regions", tmp_path, **ids)) == 4
