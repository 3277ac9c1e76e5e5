#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# All that a board needs, as one archive: the wheel and those that it needs, modules for one kernel, the service.
#
#   release/board_bundle.sh KERNEL ARCH      KERNEL: headers, or the tree of a kernel that was built; ARCH as Debian says it
#
# PYTHON_VERSION (3.10): the board's, for packages with compiled parts; those without a wheel come with the board's own.
set -eu
cd "$(dirname "$0")/.."
kernel=$(realpath "$1") arch=$2
out=$PWD/build/release
case $arch in
arm64) machine=aarch64 ;;
armhf) machine=armv7l ;;
amd64) machine=x86_64 ;;
*) echo "$0: unknown architecture $arch (amd64, arm64 or armhf)" >&2; exit 2 ;;
esac
version=$(sed -n 's/^__version__ = "\(.*\)"/\1/p' cm/_version.py)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
kmod/build.sh "$kernel" "$arch" "$work/modules" CM_PLSIM=n CONFIG_KUNIT= \
	CM_MODULES="cm_dma cm_icap cm_window cm_intc cm_overlay cm_clock"
release=$(modinfo -F vermagic "$work/modules/cm_dma.ko") # as uname says it, which no file of all kernels does
release=${release%% *}
name=fpga-cm-$version-$release-$arch
bundle=$work/$name files=$work/$name/files
mkdir -p "$files/usr/local/bin" "$files/etc/cm/configs" "$files/etc/systemd/system" "$files/etc/udev/rules.d"
mkdir -p "$files/usr/lib/sysusers.d" "$files/usr/lib/tmpfiles.d" "$files/etc/modprobe.d"
echo "$release" >"$bundle/kernel"
cp "$work"/modules/*.ko "$bundle/"
cp "$out/fpga_cm-$version"-*"$machine.whl" "$bundle/"
install -m 755 release/board/install "$bundle/"
install -m 755 release/board/cm "$files/usr/local/bin/"
sed 's#/usr/bin/cm #/usr/local/bin/cm #' system/systemd/cm.service >"$files/etc/systemd/system/cm.service"
install -m 644 system/udev/60-cm.rules "$files/etc/udev/rules.d/"
install -m 644 system/cm.yaml "$files/etc/cm/"
for kind in usr/lib/sysusers.d usr/lib/tmpfiles.d etc/modprobe.d; do
	install -m 644 "system/${kind##*/}/cm.conf" "$files/$kind/"
done
for package in cffi fastjsonschema numpy protobuf pyyaml pyzmq; do
	"${PYTHON:-python3}" -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: \
		--python-version "${PYTHON_VERSION:-3.10}" --platform "manylinux2014_$machine" --platform "manylinux_2_28_$machine" \
		--dest "$bundle" $package 2>/dev/null || echo "$package has no wheel for $machine: the board's own is used"
done
tar -C "$work" -czf "$out/$name.tar.gz" "$name"
echo "$out/$name.tar.gz"
