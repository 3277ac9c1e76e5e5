#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Style of the kernel code:  check.sh CHECKPATCH
#
# CHECKPATCH is scripts/checkpatch.pl of a kernel source (Debian: linux-source)
# with spelling.txt and const_structs.checkpatch beside it.  Not asked for: the
# version conditions of the compat headers, which an out-of-tree module needs,
# and BIT() in the uapi headers, which user space does not have.
set -eu
[ $# -eq 1 ] || { echo "usage: $0 path/to/checkpatch.pl" >&2; exit 2; }
cd "$(dirname "$0")"
set -- perl "$1" --no-tree --strict --terse --no-summary --max-line-length=100
"$@" -f core/*.[ch] clock/*.c icap/*.[ch] intc/*.[ch] overlay/*.c plsim/*.[ch] axidma/*.[ch] window/*.[ch] tests/kunit*.c tests/suites.h include/cm_core.h include/cm_icap_port.h include/cm_window_core.h \
	--ignore MACRO_ARG_REUSE,MACRO_ARG_PRECEDENCE
"$@" -f include/*compat.h --ignore LINUX_VERSION_CODE,CONSTANT_COMPARISON
"$@" -f uapi/*.h --ignore BIT_MACRO
echo "checkpatch: nothing to say"
