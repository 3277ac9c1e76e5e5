#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Build the modules against the kernels of several Debian suites.
#
#   matrix.sh [SUITE:ARCH…]              default: all below
#   LINUX_XLNX=DIR matrix.sh [linux-xlnx:ARCH…]   a kernel tree of one's own, such
#                                        as Xilinx' linux-xlnx; default arm64
#
# A tree of one's own must be configured (make ARCH=… defconfig, xilinx_defconfig
# or xilinx_zynq_defconfig, then modules_prepare); without the Module.symvers of
# a whole build modpost's warnings of missing symbols are left out.
#
# Prints one line for each: built, FAILED, or skipped and why.  KMOD_W=1 adds
# the kernel's own extra warnings, KMOD_SPARSE=1 sparse; any warning of either
# is a failure.  Exit status: 0 all built, 1 one failed, 3 none failed but one
# was skipped.
set -u

here=$(cd "$(dirname "$0")" && pwd)
out=${KMOD_OUT:-${CM_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/cm-vm}/kmod}
[ $# -gt 0 ] || [ -z "${LINUX_XLNX:-}" ] || set -- linux-xlnx:arm64
[ $# -gt 0 ] || set -- bookworm:arm64 bookworm:armhf bookworm:amd64 trixie:arm64 sid:arm64

failed=0
skipped=0

compiler() {
	case $1 in
	amd64) echo x86_64-linux-gnu-gcc ;;
	arm64) echo aarch64-linux-gnu-gcc ;;
	armhf) echo arm-linux-gnueabihf-gcc ;;
	esac
}

# warnings of our own files; those of the kernel's headers are not ours
own_warnings() {
	grep -E '(^|/)(core|clock|icap|intc|overlay|plsim|axidma|window|tests|include|uapi)/[a-z_]+\.[ch]:[0-9]+.*(warning|error):' "$1"
}

extra=
[ "${KMOD_W:-}" = 1 ] && extra="$extra W=1"
[ "${KMOD_SPARSE:-}" = 1 ] && extra="$extra C=2"

for pair in "$@"; do
	suite=${pair%%:*}
	arch=${pair#*:}
	if ! command -v "$(compiler "$arch")" >/dev/null; then
		echo "skipped  $suite/$arch: $(compiler "$arch") is not installed"
		skipped=1
		continue
	fi
	log=$out/$suite-$arch.log
	mkdir -p "$out/$suite-$arch"
	if [ "$suite" = linux-xlnx ]; then
		kdir=${LINUX_XLNX:?matrix.sh: say where the tree is: LINUX_XLNX=DIR}
		if [ ! -e "$kdir/include/generated/autoconf.h" ]; then
			echo "skipped  $suite/$arch: $kdir is not prepared (make ARCH=… modules_prepare)"
			skipped=1
			continue
		fi
		[ -e "$kdir/Module.symvers" ] || extra="$extra KBUILD_MODPOST_WARN=1"
	elif ! kdir=$("$here/headers.sh" "$suite" "$arch" 2>"$log"); then
		echo "skipped  $suite/$arch: $(tail -n 1 "$log")"
		skipped=1
		continue
	fi
	rm -f "$out/$suite-$arch"/*.ko
	# shellcheck disable=SC2086
	if ! "$here/build.sh" "$kdir" "$arch" "$out/$suite-$arch" $extra >"$log" 2>&1; then
		echo "FAILED   $suite/$arch: see $log"
		grep -E 'error:|ERROR' "$log" | head -n 5
		failed=1
	elif own_warnings "$log"; then
		echo "FAILED   $suite/$arch: the warnings above"
		failed=1
	else
		modules=$(cd "$out/$suite-$arch" && echo *.ko)
		release=$(basename "$kdir" | sed 's/linux-headers-//')
		[ "$suite" != linux-xlnx ] || release="$(cat "$kdir/include/config/kernel.release") $(git -C "$kdir" log -1 --format='%h %cs' 2>/dev/null)"
		echo "built    $suite/$arch: $release $modules"
	fi
done
if [ $failed = 1 ]; then exit 1; fi
if [ $skipped = 1 ]; then exit 3; fi
