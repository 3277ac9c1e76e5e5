#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Style and types of the kernel code: checkpatch --strict, the kernel's own
# extra warnings (W=1) and sparse (C=2), against one kernel's headers.
#
#   lint.sh [KDIR ARCH]        without them: Debian's headers of bookworm/amd64
#
# CHECKPATCH names checkpatch.pl (spelling.txt beside it) where neither KDIR nor
# an unpacked linux-source has it.  Exit status: 0 nothing to say, 1 something,
# 3 nothing to say, but a tool is missing and its part was skipped.
set -u

here=$(cd "$(dirname "$0")" && pwd)
cache=${CM_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/cm-vm}
failed=0
skipped=0

skip() { echo "SKIPPED  $*"; skipped=1; }

# the first checkpatch.pl that is there
checkpatch() {
	for script in "${CHECKPATCH:-}" "${1:-}/source/scripts/checkpatch.pl" "${1:-}/scripts/checkpatch.pl" \
		"$cache"/linux-source-*/linux-source-*/scripts/checkpatch.pl /usr/src/linux-source-*/scripts/checkpatch.pl; do
		if [ -f "$script" ] && [ -f "$(dirname "$script")/spelling.txt" ]; then
			echo "$script"
			return
		fi
	done
}

# whether sparse is called and sees what it should: one fault of its own kind
sparse_works() {
	probe=$(mktemp -d)
	cat >"$probe/probe.c" <<'C'
// SPDX-License-Identifier: GPL-2.0-only
#include <linux/module.h>
static int __init probe_init(void)
{
	return *(int __user *)&THIS_MODULE->state;
}
module_init(probe_init);
MODULE_LICENSE("GPL");
C
	echo 'obj-m += probe.o' >"$probe/Kbuild"
	make -s -C "$1" M="$probe" C=2 CONFIG_DEBUG_INFO_BTF_MODULES= modules >"$probe/log" 2>&1
	grep -q 'noderef' "$probe/log"
	found=$?
	rm -rf "$probe"
	return $found
}

if [ $# -eq 2 ]; then
	kdir=$1 arch=$2
else
	arch=amd64
	kdir=$("$here/headers.sh" bookworm amd64) || kdir=
fi

script=$(checkpatch "$kdir")
if [ -z "$script" ]; then
	skip "checkpatch: no checkpatch.pl (Debian: linux-source; or set CHECKPATCH)"
elif "$here/check.sh" "$script"; then
	:
else
	failed=1
fi

out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
sparse=C=2
if ! command -v sparse >/dev/null; then
	skip "sparse is not installed"
	sparse=
elif [ "$arch" = "$(dpkg --print-architecture 2>/dev/null)" ] && [ -n "$kdir" ] && ! sparse_works "$kdir"; then
	echo "FAILED   sparse finds nothing where there is something"
	failed=1
fi
if [ -z "$kdir" ]; then
	skip "W=1 and sparse: no kernel headers"
elif ! "$here/build.sh" "$kdir" "$arch" "$out" W=1 $sparse >"$out/log" 2>&1; then
	tail -n 20 "$out/log"
	failed=1
elif grep -E '(^|/)(core|clock|icap|intc|overlay|plsim|axidma|window|tests|include|uapi)/[a-z_]+\.[ch]:[0-9]+.*(warning|error):' "$out/log"; then
	failed=1
else
	echo "W=1${sparse:+, sparse}: nothing to say ($(basename "$kdir"), $arch)"
fi
[ $failed = 0 ] || exit 1
[ $skipped = 0 ] || exit 3
