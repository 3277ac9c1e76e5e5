#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: an overlay that uses a label of the base tree for a node of its own is refused, or the base keeps its label.
# Seen: fdtoverlay says nothing, and the label means the overlay's node from then on. The next overlay's interrupts
# go to a node that is no interrupt controller.
. "$(dirname "$0")/setup"
debian device-tree-compiler libfdt1
cat >base.dts <<'END'
/dts-v1/;
/ { pl: bus { }; gic: controller { interrupt-controller; #interrupt-cells = <1>; }; };
END
echo '/dts-v1/; /plugin/; &pl { gic: generic-input { }; };' >first.dtso
echo '/dts-v1/; /plugin/; &pl { camera { interrupt-parent = <&gic>; interrupts = <1>; }; };' >second.dtso
dtc -q -@ -O dtb -o base.dtb base.dts
for overlay in first second; do dtc -q -@ -O dtb -o $overlay.dtbo $overlay.dtso; done
fdtoverlay -i base.dtb -o merged.dtb first.dtbo second.dtbo
number() { fdtget -t u merged.dtb "$1" "$2"; }
python3 - "$(fdtget merged.dtb /__symbols__ gic)" "$(number /bus/camera interrupt-parent)" "$(number /bus/generic-input phandle)" <<'END'
import sys
from saw import saw
symbol, parent, newcomer = sys.argv[1:]
saw("gic means", symbol, "/bus/generic-input")
saw("the camera's interrupts go to the newcomer", parent == newcomer, True)
END
