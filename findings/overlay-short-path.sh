#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a target-path without a unit address names no node, and fdtoverlay refuses the overlay.
# Seen: libfdt takes the first node of that name, whatever its address, and says nothing: two cameras, and the overlay
# changes the one that stands first. dtc itself, Zephyr's dtlib and fdt find no such node.
. "$(dirname "$0")/setup"
debian device-tree-compiler libfdt1
pypi devicetree==0.0.2 fdt==0.3.3
tree='/dts-v1/; / { bus { camera@2000 { }; camera@1000 { }; }; };'
echo "$tree" >base.dts
echo "$tree &{/bus/camera} { };" >reference.dts
echo '/dts-v1/; /plugin/; / { fragment@0 { target-path = "/bus/camera"; __overlay__ { on; }; }; };' >change.dtso
dtc -q -O dtb -o base.dtb base.dts
dtc -q -O dtb -o change.dtbo change.dtso
status=0
fdtoverlay -i base.dtb -o merged.dtb change.dtbo 2>said || status=$?
refused=$(dtc -q -O dtb -o reference.dtb reference.dts 2>/dev/null || echo refused)
python3 - "$status$(cat said)" "$(fdtget -p merged.dtb /bus/camera@2000)" "$(fdtget -p merged.dtb /bus/camera@1000)" "$refused" <<'END'
import sys

import fdt
from devicetree import dtlib
from saw import saw

status, first, second, refused = sys.argv[1:]
saw("fdtoverlay's status, and what it says", status, "0")
saw("the first camera, the second", (first, second), ("on", ""))
saw("dtc, of &{/bus/camera} in a source", refused, "refused")
try:
    dtlib.DT("base.dts").get_node("/bus/camera")
    found = "found"
except dtlib.DTError:
    found = "no such node"
saw("dtlib", found, "no such node")
try:
    fdt.parse_dtb(open("base.dtb", "rb").read()).get_node("/bus/camera")
    found = "found"
except ValueError:
    found = "no such node"
saw("fdt", found, "no such node")
END
