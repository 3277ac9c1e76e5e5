# SPDX-License-Identifier: Apache-2.0
"""The AXI4 decouplers, simulated: protocol on the static side whatever the region does."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from conftest import HERE, needs
from simulation import simulate

RTL = HERE.parent.parent / "cm" / "design" / "rtl"

pytestmark = [needs("iverilog"), pytest.mark.timeout(600)]


@pytest.mark.parametrize(("side", "count"), [("slave", 4), ("master", 2)])
def test_a_decoupler_keeps_the_protocol(side: str, count: int, tmp_path: Path) -> None:
    top = f"tb_axi_{side}_decoupler"
    sources = [HERE / f"tb/{top}.v", *sorted(RTL.glob("cm_axi_*.v"))]
    assert len(simulate(top, sources, "cocotb_axi_decouplers", tmp_path, only=f"{side}_.*")) == count


PROOF = """
read_verilog -formal -sv {switches} {files}
prep -top formal_write_decoupler -flatten
async2sync; memory_map; opt -full; dffunmap; opt_clean; delete t:$cover
sat -seq 24 -prove-asserts -set-assumes -set-at 1 resetn 0 -verify
"""


@needs("yosys")
@pytest.mark.parametrize("switches", ["", "-DSTRICT"], ids=["any slave", "a slave that takes both at once"])
def test_address_and_data_of_a_write_begin_in_one_clock(switches: str, tmp_path: Path) -> None:
    """Of all that master and slave may do in 24 clocks, nothing breaks it; `-verify` makes a failure an error."""
    files = [RTL / "cm_axi_slave_decoupler_write.v", HERE / "tb" / "formal_write_decoupler.sv"]
    script = tmp_path / "proof.ys"
    script.write_text(PROOF.format(switches=switches, files=" ".join(map(str, files))))
    done = subprocess.run(["yosys", str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
    assert "SAT proof finished - no model found: SUCCESS!" in done.stdout
