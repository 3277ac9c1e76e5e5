# SPDX-License-Identifier: Apache-2.0
"""More interrupts of modules than a register has bits."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import MINIMAL, STREAM_MODULE, project
from conftest import HERE, needs
from simulation import simulate
from test_shared_engines import RTL, lint

from cm import schema
from cm.design.generate.generation import generate, load_design, output_folder

MANY = STREAM_MODULE.format(name="one", high=31).replace(
    "    input  wire        resetn,", "    input  wire        resetn,\n    output wire [69:0] irq,"
).replace("endmodule", "    assign irq = s_axis_tvalid ? 70'd1 << s_axis_tdata[6:0] : 70'd0;\nendmodule")  # fmt: skip


@needs("verilator")
@pytest.mark.parametrize("lines", [1, 31, 32, 33, 64, 128])
def test_the_control_registers_are_clean_for_any_number_of_lines(lines: int) -> None:
    lint("--top-module", "cm_control", f"-GIRQS={lines}", "-y", RTL, RTL / "cm_control.v")


@needs("iverilog")
@needs("verilator")
@pytest.mark.timeout(300)
def test_seventy_lines_are_distinguished_in_three_registers(tmp_path: Path) -> None:
    design = load_design(project(tmp_path, MINIMAL, one=MANY))
    out = output_folder(design.project, None)
    generate(design, out)
    config = schema.load(out / "config/small.yaml")
    place = {name: (one.status, one.bit) for name, one in config.interrupts.items()}
    assert len(place) == 70
    assert [place[f"irq_{line}"] for line in (0, 31, 32, 69)] == [
        ("irq_status", 0),
        ("irq_status", 31),
        ("irq_status_1", 0),
        ("irq_status_2", 5),
    ]
    base = config.registers["irq_status"].base_address
    offsets = {name: register.address - base for name, register in config.registers.items() if "irq" in name}
    assert list(offsets.values()) == [0x08, 0x0C, 0x20, 0x24, 0x30, 0x34]
    assert config.registers["irq_enable_2"].default == 0x3F
    hdl = out / "hdl"
    lint("--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v")
    sources = [hdl / "cm_static.v", *sorted((hdl / "lib").glob("*.v")), *sorted((HERE / "models").glob("*.v"))]
    sources += [out / "wrappers/one/cm_region_prr0.v", tmp_path / "one.v"]
    assert len(simulate("cm_static", sources, "cocotb_many_interrupts", tmp_path / "sim")) == 1
