#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: sending five bytes on a 32-bit stream that has no tkeep is an error, and so is a frame with a tkeep of its own.
# Seen: cocotbext-axi sends eight bytes, and ignores the tkeep. A length that is wrong in a test bench is not seen there.
. "$(dirname "$0")/setup"
pypi cocotb==2.1.0 cocotbext-axi==0.1.28
debian iverilog
mkdir -p bin
libraries=$(find root/usr/lib -type d -name ivl)
printf '#!/bin/sh\nexec "%s/root/usr/bin/iverilog" -B"%s/%s" "$@"\n' "$folder" "$folder" "$libraries" >bin/iverilog
printf '#!/bin/sh\nexec "%s/root/usr/bin/vvp" -M"%s/%s" "$@"\n' "$folder" "$folder" "$libraries" >bin/vvp
chmod +x bin/*
export PATH="$folder/bin:$PATH"
cat >wire.v <<'END'
`timescale 1ns/1ps
module through(input clk, rst, input [31:0] s_axis_tdata, input s_axis_tvalid, s_axis_tlast, output s_axis_tready,
               output [31:0] m_axis_tdata, output m_axis_tvalid, m_axis_tlast, input m_axis_tready);
	assign m_axis_tdata = s_axis_tdata;
	assign m_axis_tvalid = s_axis_tvalid;
	assign m_axis_tlast = s_axis_tlast;
	assign s_axis_tready = m_axis_tready;
endmodule
END
cat >bench.py <<'END'
import cocotb
from cocotb.clock import Clock
from cocotbext.axi import AxiStreamBus, AxiStreamFrame, AxiStreamSink, AxiStreamSource
from saw import saw


@cocotb.test()
async def frames(dut):
    cocotb.start_soon(Clock(dut.clk, 10, "ns").start())
    dut.rst.value = 0
    source = AxiStreamSource(AxiStreamBus.from_prefix(dut, "s_axis"), dut.clk, dut.rst)
    sink = AxiStreamSink(AxiStreamBus.from_prefix(dut, "m_axis"), dut.clk, dut.rst)
    await source.send(b"abcde")
    saw("five bytes arrive as", bytes((await sink.recv()).tdata), b"abcde\0\0\0")
    await source.send(AxiStreamFrame(b"abcdefgh", tkeep=[1, 1, 0, 0, 1, 1, 1, 1]))
    saw("six of eight bytes arrive as", bytes((await sink.recv()).tdata), b"abcdefgh")
    await source.send(AxiStreamFrame(b""))
    await source.send(b"next")
    saw("after an empty frame comes", bytes((await sink.recv()).tdata), b"next")
END
export PYTHONPATH="$folder:$PYTHONPATH"
python3 - <<'END'
import sys
from cocotb_tools.runner import get_results, get_runner
runner = get_runner("icarus")
runner.build(sources=["wire.v"], hdl_toplevel="through", log_file="build.log")
results = runner.test(hdl_toplevel="through", test_module="bench", log_file="test.log")
told = [line for line in open("test.log") if "arrive as" in line or "after an" in line or "changed" in line]
print("".join(told), end="")
sys.exit(0 if get_results(results) == (1, 0) else 1)
END
