#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Fetch Debian's kernel headers of one suite and architecture into the cache
# and print the folder to build external modules against.
#
#   headers.sh SUITE ARCH        e.g. headers.sh bookworm arm64
#
# Downloads and unpacks only; nothing is installed on the host.  The mirror is
# the one the host's apt uses.  The build tools inside (modpost, fixdep) are
# those of the host's architecture; where they want a newer C library than the
# host's, they run with the suite's own.
#
# Exit status: 0, 1 the suite or a package cannot be had, 2 usage.
set -eu

[ $# -eq 2 ] || { echo "usage: $0 SUITE ARCH" >&2; exit 2; }
suite=$1
arch=$2
host=$(dpkg --print-architecture)
cache=${CM_VM_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/cm-vm}/headers
state=$cache/apt-$suite-$arch

die() { echo "headers.sh: $suite/$arch: $*" >&2; exit 1; }

mirror() {
	apt-get indextargets --format '$(ORIGIN) $(RELEASE) $(REPO_URI)' 'Created-By: Packages' |
		awk '$1 == "Debian" && $2 !~ /security|updates|backports/ { print $3; exit }'
}

write_sources() {
	uri=$(mirror)
	[ -n "$uri" ] || die "no Debian mirror in the host's apt configuration"
	mkdir -p "$state/lists/partial" "$state/archives/partial" "$state/etc"
	printf 'deb [arch=%s,%s,i386] %s %s main\n' "$arch" "$host" "$uri" "$suite" >"$state/sources.list"
	: >"$state/status"
}

apt() {
	tool=$1
	shift
	"$tool" -o Dir::Etc::sourcelist="$state/sources.list" -o Dir::Etc::sourceparts=/nonexistent \
		-o Dir::State="$state" -o Dir::State::status="$state/status" -o Dir::State::lists="$state/lists" \
		-o Dir::Cache="$state" -o Dir::Cache::archives="$state/archives" \
		-o APT::Architecture="$host" -o APT::Architectures::="$host" -o APT::Architectures::="$arch" -o APT::Architectures::=i386 \
		-o APT::Get::List-Cleanup=false -o Acquire::Languages=none -o APT::Sandbox::User=root "$@"
}

flavour() {
	case $arch in
	armhf) echo armmp ;;
	*) echo "$arch" ;;
	esac
}

# the dependencies of one package, one name a line, without versions
depends() {
	apt apt-cache show --no-all-versions "$1:$arch" | sed -n 's/^Depends: //p' | head -n 1 |
		tr ',' '\n' | sed 's/^ *//; s/[ :|].*//'
}

update() {
	# lists of today will do
	if [ -e "$state/updated" ] && [ -n "$(find "$state/updated" -mmin -1440)" ]; then return 0; fi
	if ! apt apt-get -q -q update >"$state/update.log" 2>&1; then
		die "the package lists cannot be had ($(grep -m 1 '^[EW]:' "$state/update.log" || echo 'no reason given'))"
	fi
	touch "$state/updated"
}

# unpack PACKAGE...: download and extract below $tree
unpack() {
	mkdir -p "$tree.new/debs"
	(cd "$tree.new/debs" && apt apt-get -q -q download "$@" >&2) || die "cannot download $*"
	for deb in "$tree.new"/debs/*.deb; do
		dpkg-deb -x "$deb" "$tree.new"
		rm "$deb"
	done
}

# wrap_tools LIBC FILE...: run programs with the C library unpacked in LIBC
wrap_tools() {
	loader=$(find "$1/" -name 'ld-linux*.so.*' ! -type d -print -quit)
	libs=$(find "$1/" -name libc.so.6 -printf '%h' -quit)
	shift
	for tool in "$@"; do
		mv "$tool" "$tool.elf"
		printf '#!/bin/sh\nexec %s --library-path %s %s "$@"\n' "$loader" "$libs" "$tool.elf" |
			sed "s|$tree.new|$tree|g" >"$tool"
		chmod +x "$tool"
	done
}

# the programs among the build tools, not their scripts
programs() {
	find "$tree.new/usr/lib" -type f -perm -u+x | while read -r tool; do
		[ "$(head -c 4 "$tool" | tail -c 3)" = ELF ] && echo "$tool" || :
	done
}

# whether the host can run the build tools as they are
tools_run() {
	for tool in $(find "$tree.new/usr/lib" -name fixdep -type f); do
		"$tool" 2>&1 | grep -q -e GLIBC -e 'not found' && return 1
	done
	for tool in $(find "$tree.new/usr/lib" -name 'modpost.real-lsb-64' -type f); do
		"$tool" -n 2>&1 | grep -q -e GLIBC -e 'not found' && return 1
	done
	return 0
}

# the files hold absolute paths of the package; point them into the cache
relocate() {
	find "$tree.new/usr/src" -maxdepth 2 \( -name Makefile -o -name '.kernelvariables' \) -exec \
		sed -i "s|/usr/src/|$tree/usr/src/|g; s|/usr/lib/linux|$tree/usr/lib/linux|g" {} +
}

# modpost knows the structures of one word size, that of the machine it was built for
use_32bit_modpost() {
	whole=$tree
	tree=$whole.part
	unpack "$kbuild:i386" libc6:i386
	mv "$tree.new" "$whole.new/32"
	tree=$whole
	modpost=$(find "$tree.new/32" -name modpost.real-lsb-32)
	wrap_tools "$tree.new/32" "$modpost"
	for tool in $(find "$tree.new/usr/lib" -name modpost); do
		cp "$modpost" "$tool"
	done
}

write_sources
update
headers=$(depends "linux-headers-$(flavour)" | grep '^linux-headers-' | head -n 1)
[ -n "$headers" ] || die "the suite has no package linux-headers-$(flavour)"
tree=$cache/$suite-$arch-$headers
kdir=$tree/usr/src/$headers
if [ ! -e "$tree/.done" ]; then
	rm -rf "$tree.new" "$tree"
	common=$(depends "$headers" | grep -- '-common' | head -n 1)
	kbuild=$(depends "$headers" | grep '^linux-kbuild' | head -n 1)
	echo "headers.sh: $suite/$arch: downloading $headers, $common, $kbuild" >&2
	unpack "$headers:$arch" "$common" "$kbuild:$host"
	if ! tools_run; then
		echo "headers.sh: $suite/$arch: its build tools need the suite's own C library" >&2
		whole=$tree
		tree=$whole.part
		unpack "libc6:$host"
		mv "$tree.new" "$whole.new/libc"
		tree=$whole
		wrap_tools "$tree.new/libc" $(programs)
		# the dispatcher looks for its variants beside its own name
		for tool in $(find "$tree.new/usr/lib" -name modpost); do
			ln -sf modpost.real-lsb-64 "$tool"
		done
	fi
	if [ "$host/$arch" = amd64/armhf ]; then use_32bit_modpost; fi
	relocate
	mv "$tree.new" "$tree"
	touch "$tree/.done"
fi
echo "$kdir"
