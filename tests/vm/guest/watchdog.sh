# SPDX-License-Identifier: Apache-2.0
# While the tests run: when nothing was printed for a while, says on the console which tasks are stuck where, and when
# that goes on ends pytest, which then prints the stacks of its threads; sourced.
watchdog() { # file that grows
	size=-1
	silent=0
	while sleep "$CM_VM_QUIET"; do
		now=$(stat -c %s "$1")
		if [ "$now" = "$size" ]; then
			echo "cm: no output for $CM_VM_QUIET s" >/dev/kmsg
			echo w >/proc/sysrq-trigger
			for stack in /proc/[0-9]*/stack; do
				pid=${stack#/proc/}
				pid=${pid%/stack}
				[ -n "$(tr -d "\0" <"/proc/$pid/cmdline")" ] && echo "cm: $pid $(tr '\0' ' ' <"/proc/$pid/cmdline" | cut -c 1-60): $(tr '\n' ' ' <"$stack")" >/dev/kmsg
			done
			silent=$((silent + 1))
			[ "$silent" -ge 4 ] && for pid in $(pidof python3); do
				tr '\0' ' ' <"/proc/$pid/cmdline" | grep -q ' -m pytest ' && kill -ABRT "$pid"
			done
		else
			silent=0
		fi
		size=$now
	done
}
