# SPDX-License-Identifier: Apache-2.0
# Misbehaves on purpose: the host must find a leak, or a warning and a use after free, in what this board says.
. "$here/results.sh"
mkdir -p /tmp/results
if modprobe kmemleak-test 2>/dev/null; then
	rmmod kmemleak-test
	scan_for_leaks
fi
if modprobe lkdtm 2>/dev/null; then
	for crash in WARNING READ_AFTER_FREE; do
		echo "$crash" >/sys/kernel/debug/provoke-crash/DIRECT
	done
fi
printf 'status=0\nkernel=%s\n' "$(uname -r)" >/tmp/results/facts
send_results
