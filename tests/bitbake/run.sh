#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# The layer before BitBake itself, offline: all its recipes parsed, and the environment of each made, for every series.
#
#   OECORE=DIR tests/bitbake/run.sh [scarthgap|wrynose]…
#
# DIR holds git repositories (with all branches) openembedded-core, bitbake and meta-openembedded. BitBake refuses to be
# root: as root it is run as $OEUSER (nobody). Recipes of the other layers are masked, so that a parse takes seconds;
# what they would build counts as there.  Exit status 77 where something is missing.
set -eu
cd "$(dirname "$0")/../.."
skip() { echo "SKIPPED: the layer under BitBake: $*" >&2; exit 77; }
[ -n "${OECORE:-}" ] || skip "OECORE names no folder with openembedded-core, bitbake and meta-openembedded"
for name in openembedded-core bitbake meta-openembedded; do
	[ -e "$OECORE/$name" ] || skip "$OECORE/$name is missing"
done
for tool in chrpath diffstat gawk lz4c zstd cpio file git; do
	command -v $tool >/dev/null || skip "$tool is missing (Debian: chrpath diffstat gawk lz4 zstd cpio file)"
done
locale -a | grep -qi 'en_US.utf-\?8' || skip "BitBake wants the locale en_US.UTF-8"
[ $# -gt 0 ] || set -- scarthgap wrynose

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
chmod 755 "$work"
mkdir -p "$work/home"
printf '[safe]\n\tdirectory = *\n' >"$work/home/.gitconfig"
cp -r yocto/meta-cm "$work/meta-cm"
user=${OEUSER:-nobody}

bitbake_of() {
	case $1 in scarthgap) echo 2.8 ;; wrynose) echo 2.18 ;; *) skip "no version of BitBake is known for $1" ;; esac
}

clone() { # repository branch place
	git -c safe.directory='*' clone -q --local --shared --no-tags -b "$2" "$OECORE/$1" "$3"
	echo "$1 $(git -C "$3" log -1 --format='%h %cs')"
}

in_build() { # series command…
	series=$1
	shift
	as=
	[ "$(id -u)" != 0 ] || as="runuser -u $user --"
	$as env -i HOME="$work/home" USER="$user" LANG=en_US.UTF-8 TERM=dumb PATH="$PATH" BITBAKEDIR="$work/$series/bitbake" \
		bash -c "cd $work/$series && . oe-core/oe-init-build-env build >/dev/null && $*"
}

configure() { # series
	place=$work/$1
	mkdir -p "$place/build/conf"
	cat >"$place/build/conf/bblayers.conf" <<-EOF
		BBPATH = "\${TOPDIR}"
		BBFILES ?= ""
		BBLAYERS = "$place/oe-core/meta $place/meta-oe/meta-oe $place/meta-oe/meta-python $work/meta-cm"
	EOF
	cat >"$place/build/conf/local.conf" <<-EOF
		MACHINE = "qemuarm64"
		INIT_MANAGER = "systemd"
		DISTRO_FEATURES:append = " ptest"
		BB_NO_NETWORK = "1"
		CONNECTIVITY_CHECK_URIS = ""
		BBMASK += "/meta/recipes-.*/ /meta-oe/recipes-.*/ /meta-oe/dynamic-layers/ /meta-python/"
		ASSUME_PROVIDED += "^(?!python3-fpga-cm|cm-|packagegroup-cm|kernel-module-cm).*\$"
		ASSUME_PROVIDED += "python3-fpga-cm-native"
	EOF
	[ "$(id -u)" != 0 ] || chown -R "$user" "$work"
}

status=0
for series; do
	mkdir -p "$work/$series"
	echo "== $series"
	clone openembedded-core "$series" "$work/$series/oe-core"
	clone bitbake "$(bitbake_of "$series")" "$work/$series/bitbake"
	clone meta-openembedded "$series" "$work/$series/meta-oe"
	configure "$series"
	in_build "$series" "bitbake -p" >"$work/log" 2>&1 || status=1
	grep -E "^ERROR|^Parsing of" "$work/log" || tail -20 "$work/log"
	for recipe in "$work"/meta-cm/recipes-*/*/*.bb; do
		name=$(basename "$recipe" .bb)
		if in_build "$series" "bitbake -e ${name%%_*}" >"$work/log" 2>&1; then
			echo "good: ${name%%_*}"
		else
			echo "FAILED: ${name%%_*}"
			tail -20 "$work/log"
			status=1
		fi
	done
done
exit $status
