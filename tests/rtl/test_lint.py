# SPDX-License-Identifier: Apache-2.0
"""Verilator's lint with every warning, and Icarus' elaboration, of all Verilog that is shipped or generated."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from build_support import EXAMPLES, NAMES, copy_examples, generated
from conftest import HERE, needs

from cm.design.generate.generation import Design

RTL = HERE.parent.parent / "cm" / "design" / "rtl"


def lint(*words: str | Path) -> None:
    done = subprocess.run(["verilator", "--lint-only", "-Wall", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr


@pytest.fixture(scope="module", params=NAMES)
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Design, Path]:
    return generated(copy_examples(tmp_path_factory.mktemp("lint")), request.param)


@needs("verilator")
@pytest.mark.parametrize("name", sorted(path.stem for path in RTL.glob("*.v")))
def test_a_library_module_is_clean(name: str) -> None:
    lint("--top-module", name, "-y", RTL, "-y", HERE / "models", RTL / f"{name}.v")


@needs("verilator")
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*/hdl/*.v")), ids=lambda path: path.stem)
def test_an_example_module_is_clean(path: Path) -> None:
    lint("--top-module", path.stem, "-y", path.parent, "-y", EXAMPLES / "camera/hdl", path)


@needs("verilator")
def test_the_generated_static_part_is_clean(built: tuple[Design, Path]) -> None:
    hdl = built[1] / "hdl"
    lint("--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v")


@needs("verilator")
def test_the_generated_top_is_clean_beside_a_stand_in_of_the_block_design(
    built: tuple[Design, Path], tmp_path: Path
) -> None:
    hdl = built[1] / "hdl"
    (tmp_path / "cm_system_wrapper.v").write_text(stand_in((hdl / "cm_top.v").read_text()))
    folders = [word for folder in (hdl, hdl / "lib", HERE / "models", tmp_path) for word in ("-y", folder)]
    lint("--top-module", "cm_top", *folders, hdl / "cm_top.v")


def stand_in(top: str) -> str:
    """The block design's wrapper with the ports that the top connects; what the static part drives is its input."""
    body = top[top.index("cm_system_wrapper system (") :]
    pins = re.findall(r"\.(\w+)\((.*)\)", body[: body.index(");")])
    by_name = {name: int(high) + 1 for high, name in re.findall(r"\[(\d+):0\] (\w+)", top)}
    masters = ("awready", "wready", "bvalid", "bresp", "bid", "arready", "rvalid", "rdata", "rresp", "rlast", "rid")
    ports = []
    for pin, net in pins:
        width = by_name.get(net, 1)
        constant = re.match(r"(\d+)'b|\{(\d+)\{", net)
        if constant:
            width = int(constant[1] or constant[2])
        answer = pin.rsplit("_", 1)[-1] in masters
        if pin.startswith(("DDR_", "FIXED_IO_")):
            direction = "inout "
        elif pin.startswith(("clk_", "resetn_")):
            direction = "output"
        elif pin == "irq":
            direction = "input "
        elif pin.startswith("axis_"):
            to_region = "to_" in pin or "icap" in pin
            direction = "input " if pin.endswith("_tready") is to_region else "output"
        else:
            direction = "output" if pin.startswith("s_axi_") is answer else "input "
        ports.append(f"    {direction} wire [{width - 1}:0] {pin}")
    off = "/* verilator lint_off UNDRIVEN */\n/* verilator lint_off UNUSEDSIGNAL */\n"
    return f"{off}(* black_box *)\nmodule cm_system_wrapper (\n" + ",\n".join(ports) + "\n);\nendmodule\n"


@needs("verilator")
def test_every_wrapper_is_clean(built: tuple[Design, Path]) -> None:
    design, out = built
    for one in design.system.implementations:
        folders = {path.parent for path in one.module.sources}
        search = [word for folder in [*sorted(folders), out / "hdl/lib"] for word in ("-y", folder)]
        lint(*search, out / f"wrappers/{one.name}/{one.region.module}.v")


@needs("iverilog")
def test_icarus_elaborates_the_static_part_with_wrappers_in_it(built: tuple[Design, Path], tmp_path: Path) -> None:
    design, out = built
    chosen = [design.system.implementation(module, region) for region, module in
              design.project.modes[design.project.default_mode].modules.items()]  # fmt: skip
    sources = [out / f"wrappers/{one.name}/{one.region.module}.v" for one in chosen]
    sources += dict.fromkeys(path for one in chosen for path in one.module.sources)
    command = ["iverilog", "-g2005", "-Wall", "-Wno-timescale", "-s", "cm_static", "-o", str(tmp_path / "a.out")]
    files = [out / "hdl/cm_static.v", *sorted((out / "hdl/lib").glob("*.v")), *sorted((HERE / "models").glob("*.v"))]
    done = subprocess.run([*command, *map(str, [*files, *sources])], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr
