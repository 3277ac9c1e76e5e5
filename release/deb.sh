#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Debian packages of each architecture into build/release, from the source archive and the wheels; checked by lintian.
#
#   release/deb.sh SDIST WHEELS ARCH…
set -eu
cd "$(dirname "$0")/.."
sdist=$(realpath "$1")
wheels=$(realpath "$2")
shift 2
out=$PWD/build/release
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export TMPDIR=$work # lintian leaves files there
version=$(basename "$sdist" .tar.gz)
version=${version#fpga_cm-}
mkdir -p "$out"
for tool in dpkg-buildpackage dh lintian; do
	command -v $tool >/dev/null || { echo "$tool is missing (Debian: debhelper dh-dkms dh-python dpkg-dev lintian)" >&2; exit 77; }
done

all=-b
for arch; do
	rm -rf "$work/$arch"
	mkdir -p "$work/$arch"
	cp "$sdist" "$work/$arch/fpga-cm_$version.orig.tar.gz"
	tar -C "$work/$arch" -xzf "$sdist"
	cp -r debian "$work/$arch/fpga_cm-$version/debian"
	cp system/systemd/cm.service "$work/$arch/fpga_cm-$version/debian/fpga-cm.cm.service"
	cp system/udev/60-cm.rules "$work/$arch/fpga_cm-$version/debian/fpga-cm.cm.udev"
	cp system/tmpfiles.d/cm.conf "$work/$arch/fpga_cm-$version/debian/fpga-cm.tmpfiles"
	cp "$out"/man/*.[1-8] "$work/$arch/fpga_cm-$version/debian/"
	cp kmod/dkms.conf "$work/$arch/fpga_cm-$version/debian/fpga-cm-dkms.dkms"
	log=$work/$arch.log
	(cd "$work/$arch/fpga_cm-$version" &&
		CM_WHEELS=$wheels DEB_BUILD_OPTIONS="nocheck noautodbgsym" dpkg-buildpackage -a"$arch" -d -us -uc $all) >"$log" 2>&1 || {
		tail -40 "$log" >&2
		exit 1
	}
	# not for Debian's archive, and the project has no public mailbox yet
	lintian --fail-on error,warning --tag-display-limit 0 --suppress-tags \
		bogus-mail-host,bogus-mail-host-in-debian-changelog,initial-upload-closes-no-bugs "$work/$arch"/*.changes \
		2>"$work/lintian.log" || { cat "$work/lintian.log" >&2; exit 1; }
	cp "$work/$arch"/*.deb "$out/"
	all=-B # packages for all architectures come from the first
done
ls "$out"/*.deb
