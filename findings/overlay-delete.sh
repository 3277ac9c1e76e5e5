#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: /delete-node/ and /delete-property/ in an overlay either remove something when it is applied, or are errors.
# Seen: dtc compiles them to nothing, exits with 0 and warns of nothing. An overlay can only add and replace.
. "$(dirname "$0")/setup"
debian device-tree-compiler libfdt1
echo '/dts-v1/; / { pl: bus { ranges; old@1000 { }; }; };' >base.dts
echo '/dts-v1/; /plugin/; &pl { /delete-property/ ranges; /delete-node/ old@1000; };' >away.dtso
dtc -q -@ -O dtb -o base.dtb base.dts
dtc -@ -O dtb -o away.dtbo away.dtso 2>said
fdtoverlay -i base.dtb -o merged.dtb away.dtbo
python3 - "$(fdtget -l merged.dtb /bus)" "$(fdtget -p merged.dtb /bus | paste -s -d' ')" <<'END'
import sys
from pathlib import Path
from saw import saw
saw("dtc said", Path("said").read_text(), "")
saw("nodes below the bus afterwards", sys.argv[1], "old@1000")
saw("the bus still has its ranges", "ranges" in sys.argv[2].split(), True)
END
