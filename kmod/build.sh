#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Build the modules out of the source tree.
#
#   build.sh KDIR ARCH OUT [make arguments…]     ARCH as Debian says it
#
# The modules, and nothing else, are in OUT afterwards.
set -eu

[ $# -ge 3 ] || { echo "usage: $0 KDIR ARCH OUT [make arguments]" >&2; exit 2; }
kdir=$1
arch=$2
out=$3
shift 3
here=$(cd "$(dirname "$0")" && pwd)

case $arch in
amd64) karch=x86_64 triplet=x86_64-linux-gnu ;;
arm64) karch=arm64 triplet=aarch64-linux-gnu ;;
armhf) karch=arm triplet=arm-linux-gnueabihf ;;
*) echo "$0: unknown architecture $arch (amd64, arm64 or armhf)" >&2; exit 2 ;;
esac
command -v "$triplet-gcc" >/dev/null || {
	echo "$0: $triplet-gcc is missing (Debian: gcc-$(echo "$triplet" | tr _ -))" >&2
	exit 1
}

# the headers' configuration is that of the compiler the kernel was built with
if ! echo | "$triplet-gcc" -fmin-function-alignment=8 -E - >/dev/null 2>&1; then
	# what ftrace patches has to be aligned: without it, it stops the kernel when such a module is loaded
	set -- CONFIG_CC_HAS_MIN_FUNCTION_ALIGNMENT= CC_FLAGS_FTRACE= "$@"
fi

# there is no vmlinux to take BTF from
set -- CONFIG_DEBUG_INFO_BTF_MODULES= "$@"

mkdir -p "$out"
work=$(mktemp -d "$out/.work.XXXXXX")
trap 'rm -rf "$work"' EXIT
for part in Kbuild include uapi core clock icap intc overlay plsim axidma window tests; do
	cp -r "$here/$part" "$work/"
done
make -s -C "$kdir" M="$work" ARCH=$karch CROSS_COMPILE="$triplet-" CC="$triplet-gcc" -j2 modules "$@" >&2
mv "$work"/*.ko "$out/"
cp "$work/Module.symvers" "$out/"
