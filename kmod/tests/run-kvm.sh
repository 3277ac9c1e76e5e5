#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
#
# Load the modules in a virtual machine of the host's kind and exercise them:
#
#   run-kvm.sh KERNEL MODULES-OF-THE-KERNEL MODULES-BUILT [SCRIPT]
#
# KERNEL is an image, MODULES-OF-THE-KERNEL its folder below lib/modules,
# MODULES-BUILT what build.sh made, with the test programs beside them.  Needs
# qemu-system-x86, busybox-static, cpio.  Emulated where /dev/kvm is not there or
# runs nothing, as in some virtual machines, and with ACCEL=tcg.  Exit status:
# that of the guest's tests, 3 where a tool is missing.
set -eu
[ $# -ge 3 ] || { echo "usage: $0 KERNEL KERNEL-MODULES BUILT [SCRIPT]" >&2; exit 2; }
kernel=$1 stock=$2 built=$3
script=${4:-$(dirname "$0")/guest.sh}
for tool in qemu-system-x86_64 busybox cpio; do
	command -v $tool >/dev/null || { echo "$0: $tool is missing" >&2; exit 3; }
done
root=$(mktemp -d)
trap 'rm -rf "$root"' EXIT
mkdir -p "$root/bin" "$root/proc" "$root/sys" "$root/dev" "$root/tmp" "$root/modules"
cp "$(command -v busybox)" "$root/bin/busybox"
for name in configfs uio; do
	find "$stock" -name "$name.ko*" -exec cp {} "$root/modules/" \;
done
cp "$built"/*.ko "$root/modules/"
find "$built" -maxdepth 1 -name 'smoke_*' -exec cp {} "$root/bin/" \;
cp "$script" "$root/init.tests"
cat >"$root/init" <<'INIT'
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs dev /dev
mount -t debugfs debugfs /sys/kernel/debug
sh /init.tests
echo "exit status $?"
poweroff -f
INIT
chmod +x "$root/init"
(cd "$root" && find . | cpio -o -H newc --quiet | gzip -1) >"$root.cpio.gz"
trap 'rm -rf "$root" "$root.cpio.gz"' EXIT

# whether the kernel says anything under KVM: where it is there and broken, a guest says nothing for ever
kvm_works() {
	[ -w "${KVM:-/dev/kvm}" ] || return 1
	timeout -k 1 "${KVM_PATIENCE:-20}" qemu-system-x86_64 -accel kvm -cpu host -m 512 -nodefaults -display none \
		-no-reboot -serial "file:$root/probe" -kernel "$kernel" \
		-append "console=ttyS0 earlyprintk=ttyS0 panic=-1" </dev/null >/dev/null 2>&1 &
	probe=$!
	while kill -0 $probe 2>/dev/null && ! grep -q 'Linux version' "$root/probe" 2>/dev/null; do sleep 0.2; done
	kill $probe 2>/dev/null || :
	wait $probe 2>/dev/null || :
	grep -q 'Linux version' "$root/probe" 2>/dev/null
}

accel=tcg cpu=max
if [ "${ACCEL:-kvm}" = kvm ]; then
	if kvm_works; then accel=kvm cpu=host; else echo "run-kvm.sh: no working /dev/kvm, the guest is emulated" >&2; fi
fi
timeout ${LIMIT:-120} qemu-system-x86_64 -accel $accel -cpu $cpu -m 512 -smp 2 -nographic -no-reboot -nodefaults -serial stdio \
	-kernel "$kernel" -initrd "$root.cpio.gz" -append "console=ttyS0 quiet panic=-1 oops=panic" </dev/null |
	tee "$root/log"
grep -q 'exit status 0' "$root/log"
