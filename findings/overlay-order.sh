#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: applying an overlay adds its nodes in the order in which it has them.
# Seen: libfdt puts each new node first, so that siblings come out in the opposite order. A provider that the
# overlay has before its consumer is behind it in the merged tree, which is the order in which a kernel makes devices.
. "$(dirname "$0")/setup"
debian device-tree-compiler libfdt1
cat >base.dts <<'END'
/dts-v1/;
/ { pl: bus { #address-cells = <1>; #size-cells = <1>; ranges; }; };
END
cat >design.dtso <<'END'
/dts-v1/; /plugin/;
&pl {
	#address-cells = <1>; #size-cells = <1>;
	clocks: clock@1000 { reg = <0x1000 0x10>; #clock-cells = <0>; };
	dma: dma@2000 { reg = <0x2000 0x10>; clocks = <&clocks>; };
	client@3000 { reg = <0x3000 0x10>; dmas = <&dma>; };
};
END
dtc -q -@ -O dtb -o base.dtb base.dts
dtc -q -@ -O dtb -o design.dtbo design.dtso
fdtoverlay -i base.dtb -o merged.dtb design.dtbo
fdtget -l design.dtbo /fragment@0/__overlay__ >inside
fdtget -l merged.dtb /bus >merged
python3 - <<'END'
from pathlib import Path
from saw import saw
saw("in the overlay", Path("inside").read_text().split(), ["clock@1000", "dma@2000", "client@3000"])
saw("in the merged tree", Path("merged").read_text().split(), ["client@3000", "dma@2000", "clock@1000"])
END
