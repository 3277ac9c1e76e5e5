#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: lopper runs once it is installed, and turns an overlay into source that compiles to the same overlay.
# Seen: it imports a package that it does not ask for (pyyaml). As .dts the overlay's __fixups__ come out empty, with
# exit status 0, so that it can be applied to nothing; as .dtb they are kept.
. "$(dirname "$0")/setup"
pypi lopper==1.6.0
debian device-tree-compiler libfdt1
alone=$(lopper --help 2>&1 | tail -n 1 || true)
venv/bin/pip install -qq --disable-pip-version-check pyyaml==6.0.3
echo '/dts-v1/; /plugin/; &pl { camera { clocks = <&clock>; }; };' >design.dtso
dtc -q -@ -O dtb -o design.dtb design.dtso
for to in dts dtb; do lopper -f design.dtb out.$to >/dev/null 2>&1 && echo 0 >status.$to || echo $? >status.$to; done
fixups() { dtc -q -I "$1" -O dtb "out.$1" | fdtget -p - /__fixups__ | sort | paste -s -d' '; }
python3 - "$alone" "$(cat status.dts status.dtb | paste -s -d' ')" "$(fixups dts)" "$(fixups dtb)" <<'END'
import sys
from saw import saw
for what, value, before in zip(
    ("installed alone", "exit statuses", "labels in the .dts", "labels in the .dtb"),
    sys.argv[1:],
    ("ModuleNotFoundError: No module named 'yaml'", "0 0", "", "clock pl"),
):
    saw(what, value, before)
END
