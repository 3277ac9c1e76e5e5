# SPDX-License-Identifier: Apache-2.0
"""The model of a DSP48E1 compared with that of yosys, for random parameters and inputs."""

from __future__ import annotations

import random
import shutil
import subprocess
from pathlib import Path

import pytest

import cm.simulation.bits

CELLS = Path("/usr/share/yosys/xilinx/cells_sim.v")
MODEL = Path(cm.simulation.bits.__file__).with_name("dsp48.v")
BUSES = {"A": 30, "B": 18, "C": 48, "D": 25}
ENABLES = [
    *("CEA1", "CEA2", "CEB1", "CEB2", "CEC", "CED", "CEAD", "CEM", "CEP"),
    *("CEINMODE", "CECTRL", "CEALUMODE", "CECARRYIN"),
]
RESETS = ["RSTA", "RSTB", "RSTC", "RSTD", "RSTM", "RSTP", "RSTINMODE", "RSTCTRL", "RSTALUMODE", "RSTALLCARRYIN"]
SINGLE = ["CREG", "DREG", "ADREG", "MREG", "INMODEREG", "OPMODEREG", "ALUMODEREG", "CARRYINREG"]
MODES = [0b0000000, 0b0000101, 0b0110101, 0b0100101, 0b0001100, 0b0000011, 0b0110011, 0b0101100, 0b1100101, 0b0100011]
pytestmark = [
    pytest.mark.open,
    pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs iverilog, which is not installed"),
    pytest.mark.skipif(not CELLS.is_file(), reason="needs yosys' models of cells, which are not installed"),
]


def bench(source: random.Random) -> str:
    """Both models with the same parameters and inputs; prints P where they differ, and the number of values."""
    registers = {name: source.randrange(2) for name in SINGLE} | {
        name: source.randrange(3) for name in ("AREG", "BREG")
    }
    registers["PREG"] = 1  # yosys' model wants it for what feeds P back
    dport = source.randrange(2)
    shared = ", ".join(f".{name}({value})" for name, value in registers.items())
    wires = [f"reg [{width - 1}:0] {name} = 0;" for name, width in BUSES.items()]
    wires += [f"reg {name} = 0;" for name in (*ENABLES, *RESETS, "CARRYIN", "CLK")]
    ports = ", ".join(f".{name}({name})" for name in (*BUSES, *ENABLES, *RESETS, "CARRYIN", "CLK"))
    modes = "reg [4:0] INMODE = 0; reg [6:0] OPMODE = 0; reg [3:0] ALUMODE = 0; reg [2:0] CARRYINSEL = 0;"
    ports += ", .INMODE(INMODE), .OPMODE(OPMODE), .ALUMODE(ALUMODE)"
    unused = ".ACIN(30'd0), .BCIN(18'd0), .PCIN(48'd0), .CARRYCASCIN(1'b0), .MULTSIGNIN(1'b0), .CARRYINSEL(CARRYINSEL)"
    yosys = f"{shared}, .CARRYINSELREG(0)"
    yosys += f", .ACASCREG({min(registers['AREG'], 1)}), .BCASCREG({min(registers['BREG'], 1)})"
    yosys += f', .USE_DPORT("{"TRUE" if dport else "FALSE"}"), .USE_MULT("DYNAMIC")'
    # theirs begins with unknown values
    steps = [*(f"{name} = 1;" for name in RESETS), "CARRYINSEL = 1; #1 CARRYINSEL = 0; CLK = 1; #1 CLK = 0;"]
    for _ in range(150):
        for name, width in BUSES.items():
            steps.append(f"{name} = {width}'h{source.getrandbits(width):x};")
        steps += [f"{name} = {int(source.random() < 0.8)};" for name in (*ENABLES, "CARRYIN")]
        steps += [f"{name} = {int(source.random() < 0.05)};" for name in RESETS]
        steps.append(f"OPMODE = {source.choice(MODES)}; ALUMODE = {source.choice((0, 1, 2, 3))};")
        steps.append(f"INMODE = {source.getrandbits(5)}; #1 CLK = 1; #1 CLK = 0; #1 look;")
    return f"""module bench; {" ".join(wires)} {modes} wire [47:0] one, two; integer seen = 0;
cm_dsp48 #({shared}, .DPORT({dport})) ours ({ports}, .P(one));
DSP48E1 #({yosys}) theirs ({ports}, {unused}, .P(two));
task look; if (^two !== 1'bx) begin
if (one !== two) $display("differ %h %h", one, two); if (one != 0) seen = seen + 1; end endtask
initial begin #1 {" ".join(steps)} $display("seen %0d", seen); end endmodule
"""


@pytest.mark.parametrize("seed", range(6))
def test_it_does_what_yosys_model_does(tmp_path: Path, seed: int) -> None:
    (tmp_path / "bench.v").write_text(bench(random.Random(seed)))
    files = [str(tmp_path / "bench.v"), str(MODEL), str(CELLS)]
    subprocess.run(["iverilog", "-g2012", "-s", "bench", "-o", str(tmp_path / "run"), *files], check=True)
    said = subprocess.run([tmp_path / "run"], check=True, capture_output=True, text=True).stdout.splitlines()
    assert [line for line in said if not line.startswith("seen")] == []
    assert int(said[-1].split()[1]) > 50
