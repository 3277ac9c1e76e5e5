#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: where a record's flattened member would have the name of another port, GHDL renames one of them or says so.
# Seen: the Verilog that it writes has two ports of one name; it says nothing and exits with 0. A null range becomes a
# port of one bit.
. "$(dirname "$0")/setup"
debian ghdl-mcode ghdl-common
cat >design.vhd <<'END'
library ieee; use ieee.std_logic_1164.all;
package buses is
	type stream_t is record data : std_logic_vector(7 downto 0); valid : std_logic; end record;
end package;
library ieee; use ieee.std_logic_1164.all; use work.buses.all;
entity taker is
	port (a : in stream_t; a_data : in std_logic_vector(3 downto 0); none : in std_logic_vector(-1 downto 0);
	      q : out std_logic_vector(3 downto 0));
end entity;
architecture plain of taker is begin q <= a_data xor a.data(3 downto 0); end architecture;
END
ghdl=$(find root/usr/bin -name 'ghdl-mcode' | head -n 1)
library=$(find "$folder/root" -type d -path '*ghdl/mcode/vhdl' | head -n 1)
export GHDL_PREFIX="${library%/vhdl}"
"$folder/$ghdl" -a --std=08 design.vhd
status=0
"$folder/$ghdl" --synth --std=08 --out=verilog taker >design.v 2>said || status=$?
python3 - "$status" <<'END'
import re
import sys
from pathlib import Path
from saw import saw
text = Path("design.v").read_text()
saw("exit status, and what was said", (sys.argv[1], Path("said").read_text()), ("0", ""))
saw("ports of the name a_data", re.findall(r"input +(\[\d:0\]) a_data[,)]", text), ["[7:0]", "[3:0]"])
saw("the port without a bit", re.findall(r"input +(\[.*?\] )?none", text), [""])
END
