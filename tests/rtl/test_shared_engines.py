# SPDX-License-Identifier: Apache-2.0
"""Streams that share an MCDMA: clean under lint for any number of them, and every packet on its channel."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from build_support import MINIMAL, STREAM_MODULE, project
from conftest import HERE, needs
from simulation import simulate

from cm.design.generate.generation import generate, load_design, output_folder

RTL = HERE.parent.parent / "cm" / "design" / "rtl"
WIDTHS = (32, 8, 24)
SHARED = """\
project: {name: small, part: xc7z020clg400-1}
regions:
  r0: {interfaces: {s_axis: {engine: all}, m_axis: {engine: all}}}
  r1: {interfaces: {s_axis: {engine: all}, m_axis: {engine: all}}}
  r2: {interfaces: {s_axis: {engine: all}, m_axis: {engine: all}}}
modules:
  m0: {sources: [m0.v], regions: [r0]}
  m1: {sources: [m1.v], regions: [r1]}
  m2: {sources: [m2.v], regions: [r2]}
"""


def adder(number: int) -> str:
    """A module that adds its number, counted from 1, to every byte."""
    width = WIDTHS[number]
    body = STREAM_MODULE.format(name=f"m{number}", high=width - 1)
    lanes = ", ".join(f"s_axis_tdata[{low + 7}:{low}] + 8'd{number + 1}" for low in range(width - 8, -1, -8))
    return body.replace("assign m_axis_tdata = s_axis_tdata", f"assign m_axis_tdata = {{{lanes}}}")


def lint(*words: str | Path) -> None:
    done = subprocess.run(["verilator", "--lint-only", "-Wall", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr


@needs("verilator")
@pytest.mark.parametrize("module", ["cm_axis_join", "cm_axis_split"])
@pytest.mark.parametrize("count", [1, 2, 5, 16])
@pytest.mark.parametrize("size", [1, 4, 128])
def test_joins_and_splits_of_any_size_are_clean(module: str, count: int, size: int) -> None:
    lint("--top-module", module, f"-GCOUNT={count}", f"-GBYTES={size}", RTL / f"{module}.v")


@needs("iverilog")
@needs("verilator")
@pytest.mark.timeout(600)
def test_streams_of_three_widths_go_through_one_mcdma_and_back(tmp_path: Path) -> None:
    """The engine is played by an independent model of the bus, which sets and reads TDEST."""
    design = load_design(project(tmp_path, SHARED, **{f"m{number}": adder(number) for number in range(3)}))
    out = output_folder(design.project, None)
    generate(design, out)
    hdl = out / "hdl"
    lint("--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v")
    sources = [hdl / "cm_static.v", *sorted((hdl / "lib").glob("*.v")), *sorted((HERE / "models").glob("*.v"))]
    for number in range(3):
        sources += [out / f"wrappers/m{number}/cm_region_r{number}.v", tmp_path / f"m{number}.v"]
    assert len(simulate("cm_static", sources, "cocotb_shared", tmp_path / "sim")) == 3


NAMES = [f"r{number}" for number in range(12)]


@needs("verilator")
def test_a_static_part_that_joins_interrupt_lines_is_clean(tmp_path: Path) -> None:
    text = MINIMAL.replace("  prr0: {pblock: auto}", "\n".join(f"  {name}: {{}}" for name in NAMES))
    text += f"    regions: [{', '.join(NAMES)}]\n"
    design = load_design(project(tmp_path, text))
    hdl = output_folder(design.project, None) / "hdl"
    generate(design, hdl.parent)
    assert "assign irq_line_2 = irq_r0_s_axis | irq_r0_m_axis;" in (hdl / "cm_static.v").read_text()
    lint("--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v")
