# SPDX-License-Identifier: Apache-2.0
"""Helpers of the build tool's tests: the shipped examples, generated in the test's folder."""

from __future__ import annotations

import shutil
import textwrap
from pathlib import Path

import pytest
from verilog_ports import AXI_LITE, STREAMS

import cm
from cm.design.generate.generation import Design, generate, load_design, output_folder

EXAMPLES = Path(cm.__file__).parent / "data" / "examples"
GOLDEN = Path(__file__).parent.parent / "golden"
NAMES = ("camera", "two_regions")
SHIPPED = Path("config/camera.yaml")  # beside the camera example: what `cm demo` runs


def copy_examples(folder: Path) -> Path:
    """The examples below `folder`: some refer to files of the first."""
    for name in (*NAMES, "wide"):
        shutil.copytree(EXAMPLES / name, folder / name)
    return folder


def generated(folder: Path, name: str) -> tuple[Design, Path]:
    """An example with its output folder."""
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    pytest.importorskip("jinja2", reason="needs jinja2: the extra [build] is not installed")
    design = load_design(folder / name / "build.yaml")
    out = output_folder(design.project, None)
    generate(design, out)
    return design, out


def needs(program: str) -> pytest.MarkDecorator:
    """Skip where a program is not installed, and say which."""
    return pytest.mark.skipif(shutil.which(program) is None, reason=f"needs {program}, which is not installed")


MINIMAL = """\
project: {name: small, part: xc7z020clg400-1}
regions:
  prr0: {pblock: auto}
modules:
  one:
    sources: [one.v]
"""

STREAM_MODULE = (
    """\
module {name} (
    input  wire        clk,
    input  wire        resetn,
"""
    + STREAMS.replace("high_in", "high").replace("high_out", "high")
    + """\
);
    assign m_axis_tdata = s_axis_tdata;
    assign m_axis_tvalid = s_axis_tvalid;
    assign s_axis_tready = m_axis_tready;
    assign m_axis_tlast = s_axis_tlast;
endmodule
"""
)


def project(folder: Path, text: str = MINIMAL, **files: str) -> Path:
    """A build schema in `folder` with HDL files beside it (``one="…"`` is ``one.v``); ``one.v`` is there anyway."""
    sources = {"one": STREAM_MODULE.format(name="one", high=31)} | files
    for name, source in sources.items():
        (folder / f"{name}.v").write_text(source)
    path = folder / "build.yaml"
    path.write_text(textwrap.dedent(text))
    return path


AXIL_MODULE = (
    """\
module one (
    input  wire        clk,
    input  wire        resetn,
"""
    + AXI_LITE
    + """\
);
endmodule
"""
)
