#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# usage: tests/bare/run.sh [SUITE]...    (as root; needs mmdebstrap, util-linux and git)
#
# What README promises a newcomer, on an empty machine: a root of each SUITE (default: bookworm trixie) with the
# packages that README names and no others. A plain user there clones the last commit and runs the lines of
# README's "Try it", as they stand there. Then the wheel, in a root without a compiler.
#
# Where packages come from is what this machine's apt and pip are set to. build/bare/ keeps the roots.
set -euo pipefail
cd "$(dirname "$0")/../.."

say() { printf '\n-- %s: %s (%(%H:%M:%S)T) --\n' "$suite" "$*" -1; }
fail() { echo "tests/bare/run.sh: $*" >&2; exit 1; }

# You need Linux with `python3 python3-venv …`; …
readme_packages() {
	sed -n 's/^You need Linux with `\([a-z0-9 -]*\)`.*/\1/p' README.md | grep . || fail "README.md names no packages"
}

# The commands of the first block of shell under "Try it", without their comments.
readme_lines() {
	sed -n '/^## Try it$/,/^## A/{/^```sh$/,/^```$/{/^```/d;s/ *#.*//;p}}' README.md | grep . || fail "README.md says no commands"
}

# The first of this machine's package sources that has the suite.
mirror() {
	local site
	for site in $(apt-get indextargets --format '$(SITE)' | sort -u); do
		/usr/lib/apt/apt-helper download-file "$site/dists/$suite/InRelease" "$work/InRelease" >/dev/null 2>&1 && echo "$site" && return
	done
	fail "no package source of this machine has the suite $suite"
}

# How apt and pip reach their sources from here: proxies, certificates, other indices.
apt_settings() { apt-config dump | grep -E '^Acquire::(https?::|Check-|Retries)'; }
pip_settings() {
	local pip="python3 -m pip config"
	for name in index-url extra-index-url proxy trusted-host; do
		$pip list 2>/dev/null | sed -n "s/^[^.]*\.$name='\(.*\)'$/$name = \1/p" | grep -v file: | tail -n 1 || true
	done
	[ ! -e "$root/etc/ssl/certs/of-the-host.crt" ] || echo "cert = /etc/ssl/certs/of-the-host.crt"
}
certificates() {
	local named
	named=$(python3 -m pip config list 2>/dev/null | sed -n "s/^[^.]*\.cert='\(.*\)'$/\1/p" | tail -n 1)
	[ -z "$named" ] || cp "$named" "$root/etc/ssl/certs/of-the-host.crt"
}

# The root as it is after the installation, in an archive that is kept while README's packages stay the same.
install_root() {
	local packages archive
	packages="$(readme_packages) ca-certificates"
	archive=build/bare/$suite-$(echo "$packages" | cksum | cut -d ' ' -f 1).tar
	if [ ! -e "$archive" ]; then
		say "an empty root with $packages"
		apt_settings >"$work/apt.conf"
		mmdebstrap --quiet --variant=minbase --include="${packages// /,}" --aptopt="$work/apt.conf" "$suite" "$work/root.tar" "$(mirror)"
		mv "$work/root.tar" "$archive"
	fi
	mkdir "$root"
	tar -C "$root" -xf "$archive" --exclude='./dev/*'
}

furnish() {
	chroot "$root" useradd --create-home --shell /bin/bash newcomer
	cp -L /etc/resolv.conf "$root/etc/resolv.conf"
	echo "127.0.0.1 localhost $(hostname)" >"$root/etc/hosts"
	certificates
	{ echo "[global]"; pip_settings; } >"$root/etc/pip.conf"
	git -c safe.directory='*' clone -q --no-local . "$home/fpga-cm"
	chroot "$root" chown -R newcomer: /home/newcomer/fpga-cm
}

# A plain user in the root, as `su -` lets one in (by PAM, so with umask 002), with processes, shared memory and terminals
# of its own: nothing of this machine is in reach.
inside() {
	unshare --mount --pid --fork --kill-child bash -euc '
		root=$1; shift
		mount -t proc proc "$root/proc"
		mount --rbind /sys "$root/sys"
		mount -t tmpfs -o mode=755 dev "$root/dev"
		for name in null zero full random urandom tty; do touch "$root/dev/$name"; mount --bind "/dev/$name" "$root/dev/$name"; done
		mkdir "$root/dev/shm" "$root/dev/pts"
		mount -t tmpfs -o mode=1777 shm "$root/dev/shm"
		mount -t devpts -o newinstance,ptmxmode=666,mode=620,gid=5 pts "$root/dev/pts"
		ln -s pts/ptmx "$root/dev/ptmx"
		ln -s /proc/self/fd "$root/dev/fd"
		ln -s fd/0 "$root/dev/stdin"; ln -s fd/1 "$root/dev/stdout"; ln -s fd/2 "$root/dev/stderr"
		exec env -i TERM=dumb /usr/sbin/chroot "$root" /bin/su - newcomer -c "set -eu; export LANG=C.UTF-8; cd ~/fpga-cm; $*" </dev/null
	' bash "$root" "$umask$*"
}

# What fails is asked once more, so that CI's log tells a defect from a machine that was busy; it has failed all the same
# where it fails again.
readme() {
	local line
	say "umask $(inside umask)"
	while read -r line; do
		say "$line"
		time inside "$line" || {
			say "FAILED: $line; asked once more"
			inside "$line PYTEST_ARGS='--last-failed -v'"
		}
	done < <(readme_lines)
}

# A newcomer reads what was skipped; more than a few lines of it nobody does.
few_skips() {
	local skipped
	skipped=$(sed -n 's/^=.* \([0-9]*\) skipped.*=$/\1/p' "$log" | tail -n 1)
	[ "${skipped:-0}" -le 10 ] || fail "$suite: make test skipped $skipped tests; a newcomer may meet ten"
}

# A machine without a compiler gets what one with a compiler has built.
wheel() {
	say "the wheel, without a compiler"
	inside ".venv/bin/pip wheel --quiet --no-deps --wheel-dir ~ ."
	chroot "$root" dpkg --purge --force-depends gcc cpp make python3-dev 2>/dev/null >/dev/null
	inside '! type cc gcc make python3-config 2>/dev/null
		python3 -m venv ~/empty
		~/empty/bin/pip install --quiet "$(ls ~/fpga_cm-*.whl)[demo]"
		cd ~; rm -r fpga-cm; empty/bin/cm demo --out pictures; ls pictures/contact-sheet.png'
}

# The last of the roots has a umask that keeps everybody out, as careful administrators set it.
one() {
	suite=$1 umask=
	[ "$suite" != "$last" ] || umask="umask 077; "
	root=$work/$suite home=$work/$suite/home/newcomer log=build/bare/$suite.log
	install_root
	furnish
	readme 2>&1 | tee "$log"
	few_skips
	wheel
	rm -rf --one-file-system "$root"
}

[ "$(id -u)" = 0 ] || fail "needs root, to enter an empty root: sudo make test-bare"
command -v mmdebstrap >/dev/null || fail "needs mmdebstrap: apt install mmdebstrap"
mkdir -p build/bare
work=$(mktemp -d)
trap 'rm -rf --one-file-system "$work"' EXIT
[ $# -gt 0 ] || set -- bookworm trixie
last=${!#}
for suite in "$@"; do one "$suite"; done
