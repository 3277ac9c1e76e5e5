# SPDX-License-Identifier: Apache-2.0
"""The open flow's DMA engine: clean under lint, and PG021's direct register mode between others' memory and streams."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest
from conftest import HERE, needs
from simulation import simulate

RTL = HERE.parent.parent / "cm" / "design" / "openflow" / "rtl"
SOURCES = [HERE / "tb" / "tb_axi_dma.v", RTL / "cm_axi_dma.v", *sorted(RTL.glob("cm_dma_*.v"))]
SHAPES = {  # bytes of memory's words, of either stream's beats
    "bytes": {"DATA_BYTES": 8, "MM2S_BYTES": 1, "S2MM_BYTES": 1},
    "words": {"DATA_BYTES": 8, "MM2S_BYTES": 8, "S2MM_BYTES": 4},
    "narrow": {"DATA_BYTES": 4, "MM2S_BYTES": 2, "S2MM_BYTES": 2, "LENGTH_BITS": 14},
}


@needs("verilator")
@pytest.mark.parametrize(
    "parameters",
    [
        {},
        *SHAPES.values(),
        {"HAS_MM2S": 0, "S2MM_LAST": 0, "S2MM_BYTES": 2},
        {"HAS_S2MM": 0, "LENGTH_BITS": 26},
        {"DATA_BYTES": 4, "MM2S_BYTES": 4, "LENGTH_BITS": 8},
    ],
    ids=str,
)
def test_it_is_clean_under_lint(parameters: dict[str, int]) -> None:
    given = [f"-G{name}={value}" for name, value in parameters.items()]
    command = ["verilator", "--lint-only", "-Wall", *given, "-y", str(RTL), str(RTL / "cm_axi_dma.v")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs("iverilog")
@pytest.mark.parametrize("shape", SHAPES)
def test_packets_pass_between_memory_and_streams_whatever_waits(shape: str, tmp_path: Path) -> None:
    assert len(simulate("tb_axi_dma", SOURCES, "cocotb_axi_dma", tmp_path, parameters=SHAPES[shape])) == 9


@needs("iverilog")
@pytest.mark.parametrize("shape", SHAPES)
def test_pynqs_own_driver_runs_it(shape: str, tmp_path: Path) -> None:
    if not os.environ.get("CM_PYNQ"):
        pytest.skip("needs CM_PYNQ: a copy of Xilinx/PYNQ")
    assert len(simulate("tb_axi_dma", SOURCES, "cocotb_pynq_dma", tmp_path, parameters=SHAPES[shape])) == 1


PROOF = """
read_verilog -formal -sv {switches} {files}
prep -top formal_axi_dma -flatten
async2sync; memory_map; opt -full; dffunmap; opt_clean; delete t:$cover
sat -tempinduct -prove-asserts -set-assumes -set-at 1 resetn 0 -maxsteps 5 -verify
"""


@needs("yosys")
@pytest.mark.parametrize("registers", ["", "FAXIL"])
def test_what_memory_was_offered_stays_and_registers_answer_each_access_once(registers: str, tmp_path: Path) -> None:
    """Proved for all time, not only for what a simulation does; `-verify` makes a failure an error."""
    files = [*SOURCES[1:], HERE / "tb" / "formal_axi_dma.sv"]
    if registers:
        if not os.environ.get("CM_WB2AXIP"):
            pytest.skip("needs CM_WB2AXIP: a copy of ZipCPU/wb2axip")
        files.insert(0, Path(os.environ["CM_WB2AXIP"]) / "bench" / "formal" / "faxil_slave.v")
    switches = f"-D{registers}" if registers else ""
    script = tmp_path / "proof.ys"
    script.write_text(PROOF.format(switches=switches, files=" ".join(map(str, files))))
    done = subprocess.run(["yosys", str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
    assert "Induction step proven: SUCCESS!" in done.stdout
