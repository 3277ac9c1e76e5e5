#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: expressions of a device tree are reckoned as the C preprocessor's, whose headers they use: -1 < 0 is true,
# -7 / 2 is -3, -7 % 3 is -1.
# Seen: dtc reckons in unsigned numbers of 64 bits, in which nothing is below 0 and a quotient is 2^63 off. Zephyr's
# dtlib, which reads the same sources, has Python's signs and rounds down. Neither says a word, and they agree in none
# of the three.
. "$(dirname "$0")/setup"
debian device-tree-compiler libfdt1
pypi devicetree==0.0.2
cat >signs.dts <<'END'
/dts-v1/;
/ { below = /bits/ 64 <(-1 < 0)>; quotient = /bits/ 64 <(-7 / 2)>; rest = /bits/ 64 <(-7 % 3)>; };
END
dtc -O dtb -o signs.dtb signs.dts 2>said
python3 - $(for name in below quotient rest; do fdtget -t x signs.dtb / $name; done) <<'END'
import sys

from devicetree import dtlib
from saw import saw

names = "below", "quotient", "rest"
values = dtlib.DT("signs.dts").root.props
cells = [int(text, 16) for text in sys.argv[1:]]
saw("dtc", dict(zip(names, (high << 32 | low for high, low in zip(cells[::2], cells[1::2])))),
    {"below": 0, "quotient": 2**63 - 4, "rest": 0})
saw("dtlib", {name: int.from_bytes(values[name].value, "big", signed=True) for name in names},
    {"below": 1, "quotient": -4, "rest": 2})
saw("what dtc says", open("said").read(), "")
END
