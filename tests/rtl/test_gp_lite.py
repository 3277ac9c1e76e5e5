# SPDX-License-Identifier: Apache-2.0
"""The open flow's bridge from the processing system's port to registers: clean under lint, and word for word."""

from __future__ import annotations

import subprocess
from pathlib import Path

from conftest import HERE, needs
from simulation import simulate

RTL = HERE.parent.parent / "cm" / "design" / "openflow" / "rtl"


@needs("verilator")
def test_it_is_clean_under_lint() -> None:
    command = ["verilator", "--lint-only", "-Wall", str(RTL / "cm_gp_lite.v")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs("iverilog")
def test_words_and_bursts_pass_between_a_master_and_a_memory(tmp_path: Path) -> None:
    sources = [HERE / "tb" / "tb_gp_lite.v", RTL / "cm_gp_lite.v"]
    assert len(simulate("tb_gp_lite", sources, "cocotb_gp_lite", tmp_path)) == 2
