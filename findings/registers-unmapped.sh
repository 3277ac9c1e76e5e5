#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: an AXI4-Lite access to an address without a register is answered with DECERR or SLVERR, so that a wrong offset
# is noticed; and an error makes a test bench's read raise.
# Seen: corsair's Verilog answers OKAY to every access, also to writes of read-only registers; axion-hdl's answers
# SLVERR to both. cocotbext-axi's read_dword() returns the data of a failed access like any other: only read() has the
# response.
. "$(dirname "$0")/setup"
pypi corsair==1.0.4 axion-hdl==1.7.1 cocotb==2.0.1 cocotbext-axi==0.1.28
debian iverilog
ivl=$(find "$folder/root" -type d -name ivl | head -n 1)
mkdir tools
printf '#!/bin/sh\nexec "%s" -B "%s" "$@"\n' "$folder/root/usr/bin/iverilog" "$ivl" >tools/iverilog
printf '#!/bin/sh\nexec "%s" -M "%s" "$@"\n' "$folder/root/usr/bin/vvp" "$ivl" >tools/vvp
chmod +x tools/*
export PATH="$folder/tools:$PATH"

cat >regs.yaml <<'END'
regmap:
- {name: gain, description: what is written, address: 0, bitfields: [
    {name: value, description: all of it, reset: 0, width: 32, lsb: 0, access: rw, hardware: o}]}
- {name: seen, description: what is read, address: 8, bitfields: [
    {name: value, description: all of it, reset: 0, width: 32, lsb: 0, access: ro, hardware: i}]}
END
cat >csrconfig <<'END'
[globcfg]
base_address = 0
data_width = 32
address_width = 16
register_reset = sync_neg
address_increment = 4
address_alignment = 4
[v_module]
path = regs.v
interface = axil
generator = Verilog
END
corsair -r regs.yaml -c csrconfig >corsair.said
cat >filter.yaml <<'END'
module: filter
registers:
  - {name: gain, addr: 0x0, access: RW, width: 32, default: 0}
  - {name: seen, addr: 0x8, access: RO, width: 32}
END
cat >made.py <<'END'
import axion_hdl
tool = axion_hdl.AxionHDL("axion")
tool.add_yaml_src("filter.yaml")
tool.analyze()
tool.generate_systemverilog()
END
python3 made.py >axion.said

cat >asked.py <<'END'
import json
import os

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import Timer
from cocotbext.axi import AxiLiteBus, AxiLiteMaster

PREFIX, CLOCK, RESET = json.loads(os.environ["NAMES"])


@cocotb.test()
async def asks(dut) -> None:
    clock, reset = getattr(dut, CLOCK), getattr(dut, RESET)
    reset.value = 0
    Clock(clock, 10, "ns").start()
    master = AxiLiteMaster(AxiLiteBus.from_prefix(dut, PREFIX), clock, reset, reset_active_level=False)
    await Timer(50, "ns")
    reset.value = 1
    await Timer(50, "ns")
    found = {
        "read of nothing": int((await master.read(0x40, 4)).resp),
        "write to nothing": int((await master.write(0x40, bytes(4))).resp),
        "write of a read-only register": int((await master.write(8, bytes(4))).resp),
        "read_dword of nothing": await master.read_dword(0x40),
    }
    with open(os.environ["ANSWERS"], "w") as file:
        json.dump(found, file)
END
cat >run.py <<'END'
import json
import sys

from cocotb_tools.runner import get_runner

top, source, *names = sys.argv[1:]
runner = get_runner("icarus")
runner.build(sources=[source], hdl_toplevel=top, build_dir=top, timescale=("1ns", "1ps"), always=True)
runner.test(hdl_toplevel=top, test_module="asked", build_dir=top,
            extra_env={"NAMES": json.dumps(names), "ANSWERS": f"{sys.path[0]}/{top}.json"})
END
export PYTHONPATH="$folder:$PYTHONPATH"
python3 run.py regs regs.v axil clk rst >regs.log 2>&1 || cat regs.log
python3 run.py filter_axion_reg axion/filter_axion_reg.sv axi axi_aclk axi_aresetn >axion.log 2>&1 || cat axion.log
python3 - <<'END'
import json
from saw import saw
asked = ("read of nothing", "write to nothing", "write of a read-only register", "read_dword of nothing")
for tool, name, before in (("corsair", "regs", (0, 0, 0, 0)), ("axion-hdl", "filter_axion_reg", (2, 2, 2, 0))):
    found = json.load(open(f"{name}.json"))
    for what, old in zip(asked, before):
        saw(f"{tool}: {what}", found[what], old)
END
