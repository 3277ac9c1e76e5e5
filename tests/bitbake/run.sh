#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# The layer before BitBake itself, offline: all its recipes parsed, the environment of each made, and every recipe
# that makes packages taken through packaging and its checks, for arm64, with Debian's tools (stubs/).
#
#   OECORE=DIR tests/bitbake/run.sh [scarthgap|wrynose]…
#   CHECK_LAYER=1                     yocto-check-layer too, more than a quarter of an hour
#
# DIR holds git repositories (with all branches) openembedded-core, bitbake, meta-openembedded, and meta-ros if the
# recipes for ROS 2 are to be tried. BitBake refuses to be
# root: as root it is run as $OEUSER (nobody). Recipes of the other layers are masked, so that a parse takes seconds;
# what they would build counts as there.  Exit status 77 where something is missing.
set -eu
cd "$(dirname "$0")/../.."
skip() { echo "SKIPPED: the layer under BitBake: $*" >&2; exit 77; }
[ -n "${OECORE:-}" ] || skip "OECORE names no folder with openembedded-core, bitbake and meta-openembedded"
for name in openembedded-core bitbake meta-openembedded; do
	[ -e "$OECORE/$name" ] || skip "$OECORE/$name is missing"
done
for tool in chrpath diffstat gawk lz4c zstd cpio file git pseudo rpm dtc protoc patch aarch64-linux-gnu-g++; do
	command -v $tool >/dev/null || skip "$tool is missing (Debian: chrpath diffstat gawk lz4 zstd cpio file pseudo rpm" \
		"device-tree-compiler protobuf-compiler patch g++-aarch64-linux-gnu python3-build python3-installer libdw-dev)"
done
release/layer.sh "${PYTHON:-.venv/bin/python}" >/dev/null
locale -a | grep -qi 'en_US.utf-\?8' || skip "BitBake wants the locale en_US.UTF-8"
[ $# -gt 0 ] || set -- scarthgap wrynose

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
chmod 755 "$work"
mkdir -p "$work/home"
printf '[safe]\n\tdirectory = *\n' >"$work/home/.gitconfig"
cp -r yocto/meta-cm "$work/meta-cm"
cp -r tests/bitbake/stubs "$work/stubs"
repository=$PWD
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
	$as env -i HOME="$work/home" USER="$user" LANG=en_US.UTF-8 TERM=dumb PATH="$work/prepared/tools:/usr/bin:/bin:/usr/sbin:/sbin" BITBAKEDIR="$work/$series/bitbake" \
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

# what BitBake would have built before our recipes; a copy of the package, for a check that runs on the builder
prepare() { # series
	echo "preparing Debian's headers and tools"
	rm -rf "$work/prepared"
	"${PYTHON:-python3}" tests/bitbake/prepare.py "$work/prepared" "$work/$1/oe-core" || skip "what packaging needs cannot be had here"
	mkdir -p "$work/stubs/recipes/camera/files"
	cp "$work/prepared/camera.tar.gz" "$work/stubs/recipes/camera/files/"
	place=$work/$1
	cat >"$place/build/conf/bblayers.conf" <<-EOF
		BBPATH = "\${TOPDIR}"
		BBFILES ?= ""
		BBLAYERS = "$place/oe-core/meta $place/meta-oe/meta-oe $place/meta-oe/meta-python $work/meta-cm $work/stubs"
	EOF
	sed -i '/^ASSUME_PROVIDED += "^/d' "$place/build/conf/local.conf" # stubs/packaging.conf provides less
	sed -e "s|@KERNEL@|$work/prepared/kernel|; s|@PSEUDO@|$(dirname "$(find /usr/lib -name libpseudo.so | head -1)")|" \
		-e "s|@PYTHON@|$(echo "$work"/prepared/tools/include/python3.*)|; s|@HEADERS@|$work/prepared/tools/include|" \
		"$work/stubs/packaging.conf" >>"$place/build/conf/local.conf"
	chmod -R a+rX "$work/prepared" "$work/stubs"
	[ "$(id -u)" != 0 ] || chown -R "$user" "$place" "$work/prepared" "$work/stubs"
}

package() { # series: all our recipes into packages, checked by package_qa
	recipes="cm-kmod cm-overlays python3-fpga-cm packagegroup-cm cm-config-camera"
	echo "packaging $recipes"
	if in_build "$1" "bitbake -c package_qa $recipes && bitbake -c package_write_deb $recipes" >"$work/log" 2>&1; then
		grep "Tasks Summary" "$work/log"
		find "$work/$1"/build/tmp* -path '*/deploy-debs/*' -name '*.deb' -printf '%f\n' | sort -u
	else
		grep -E "^(ERROR|WARNING)|Tasks Summary|error:" "$work/log" | head -40
		cp "$work/log" "${TMPDIR:-/tmp}/bitbake-$1.log"
		status=1
	fi
	grep "^WARNING" "$work/log" | sort -u || true
}

without_systemd() { # series: the script of an older init, and what it takes
	sed -i 's/^INIT_MANAGER = .*/INIT_MANAGER = "sysvinit"/' "$work/$1/build/conf/local.conf"
	if in_build "$1" "bitbake -e python3-fpga-cm" >"$work/log" 2>&1 &&
		grep -q '^RDEPENDS:python3-fpga-cm=".* util-linux-setpriv' "$work/log"; then
		echo "good: python3-fpga-cm, for an image without systemd"
	else
		echo "FAILED: python3-fpga-cm, for an image without systemd"
		grep -E "^(ERROR:|RDEPENDS:python3-fpga-cm=)" "$work/log" || tail -20 "$work/log"
		status=1
	fi
	sed -i 's/^INIT_MANAGER = .*/INIT_MANAGER = "systemd"/' "$work/$1/build/conf/local.conf"
}

with_ros() { # series: what is there for ROS 2, where meta-ros is given too
	[ -e "$OECORE/meta-ros" ] || { echo "no meta-ros: its recipes are not tried" && return; }
	place=$work/$1
	clone meta-ros "$1" "$place/meta-ros"
	cp "$place/build/conf/bblayers.conf" "$place/build/conf/local.conf" "$place/"
	sed -i "s|$work/meta-cm\"|$place/meta-ros/meta-ros-common $place/meta-ros/meta-ros2 $place/meta-ros/meta-ros2-jazzy &|" \
		"$place/build/conf/bblayers.conf"
	# no Fortran, whose compiler it would want here
	printf 'ROS_DISTRO = "jazzy"\nROS_WORLD_SKIP_GROUPS:append = " fortran"\nBBMASK += "/meta-ros/"\n' >>"$place/build/conf/local.conf"
	[ "$(id -u)" != 0 ] || chown -R "$user" "$place"
	for name in cm-interfaces cm-ros2; do
		if in_build "$1" "bitbake -e $name >/dev/null && bitbake -c unpack $name" >"$work/log" 2>&1; then
			echo "good: $name, for ROS 2 Jazzy"
		else
			echo "FAILED: $name, for ROS 2 Jazzy"
			grep "^ERROR" "$work/log" || tail -20 "$work/log"
			status=1
		fi
	done
	mv "$place/bblayers.conf" "$place/local.conf" "$place/build/conf/"
}

check_layer() { # series
	echo "yocto-check-layer"
	layers="--dependency ../oe-core/meta ../meta-oe/meta-oe ../meta-oe/meta-python --no-auto-dependency"
	sed -i '/^BBMASK/d; /^ASSUME_PROVIDED/d' "$work/$1/build/conf/local.conf"
	sed -i "s| $work/meta-cm||" "$work/$1/build/conf/bblayers.conf"
	in_build "$1" "yocto-check-layer $work/meta-cm $layers" >"$work/log" 2>&1 || status=1
	tail -60 "$work/log"
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
	without_systemd "$series"
	with_ros "$series"
	[ -z "${CHECK_LAYER:-}" ] || check_layer "$series"
	if [ -z "${CHECK_LAYER:-}" ]; then
		prepare "$series"
		package "$series"
	fi
done
exit $status
