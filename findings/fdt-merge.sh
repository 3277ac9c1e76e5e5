#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: merging an overlay into a tree with the package `fdt` applies it.
# Seen: its fragments become nodes of the tree, with targets that mean nothing, and the labels of the overlay point into
# them. No error; the devices are nowhere that a kernel looks.
. "$(dirname "$0")/setup"
pypi fdt==0.3.3
debian device-tree-compiler libfdt1
echo '/dts-v1/; / { pl: bus { }; };' >base.dts
echo '/dts-v1/; /plugin/; &pl { lens: camera { }; };' >design.dtso
dtc -q -@ -O dtb -o base.dtb base.dts
dtc -q -@ -O dtb -o design.dtbo design.dtso
python3 - <<'END'
from pathlib import Path
import fdt
from saw import saw
tree = fdt.parse_dtb(Path("base.dtb").read_bytes())
tree.merge(fdt.parse_dtb(Path("design.dtbo").read_bytes()))
saw("the camera is on the bus", tree.exist_node("/bus/camera"), False)
saw("it is at", tree.get_property("lens", "/__symbols__").value, "/fragment@0/__overlay__/camera")
END
