# SPDX-License-Identifier: Apache-2.0
"""The example's modules synthesise for the Zynq, into what their build schema says that they take."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
from conftest import HERE, needs

from cm.design.project.load import load_project

pytestmark = [needs("yosys"), pytest.mark.timeout(600)]
EXAMPLES = HERE.parents[1] / "cm/data/examples"


def synthesised(top: str, sources: list[Path], folder: Path) -> dict[str, int]:
    """Cells by type, by yosys' flow for 7 series."""
    report = folder / "stat.json"
    files = " ".join(str(path) for path in sources)
    script = f"read_verilog {files}; synth_xilinx -family xc7 -top {top} -flatten; tee -q -o {report} stat -json"
    subprocess.run(["yosys", "-q", "-p", script], check=True, capture_output=True)
    cells: dict[str, int] = json.loads(report.read_text())["design"]["num_cells_by_type"]
    return cells


@pytest.mark.parametrize("name", ["camera/default", "camera/edge", "camera/colorise", "wide/edge"])
def test_a_module_takes_what_its_build_schema_says(name: str, tmp_path: Path) -> None:
    example, module = name.split("/")
    spec = load_project(EXAMPLES / example / "build.yaml").modules[module]
    cells = synthesised(spec.top, list(spec.sources), tmp_path)
    assert not [kind for kind in cells if kind.startswith(("$", "LD")) or "LATCH" in kind]
    flops = sum(count for kind, count in cells.items() if kind in ("FDRE", "FDSE", "FDCE", "FDPE"))
    luts = sum(count for kind, count in cells.items() if kind.startswith("LUT"))
    found = {"ff": flops, "dsp": cells.get("DSP48E1", 0)}
    assert found == {"ff": spec.resources.ff, "dsp": spec.resources.dsp}
    assert 0.7 * spec.resources.lut <= luts <= 1.3 * spec.resources.lut  # other versions map otherwise
