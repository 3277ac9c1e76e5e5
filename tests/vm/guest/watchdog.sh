# SPDX-License-Identifier: Apache-2.0
# While the tests run: when nothing was printed for a while, says on the console which tasks are stuck where; sourced.
watchdog() { # file that grows
	size=-1
	while sleep 60; do
		now=$(stat -c %s "$1")
		if [ "$now" = "$size" ]; then
			echo "cm: no output for a minute" >/dev/kmsg
			echo w >/proc/sysrq-trigger
			for stack in /proc/[0-9]*/stack; do
				pid=${stack#/proc/}
				pid=${pid%/stack}
				[ -n "$(tr -d "\0" <"/proc/$pid/cmdline")" ] && echo "cm: $pid $(tr '\0' ' ' <"/proc/$pid/cmdline" | cut -c 1-60): $(tr '\n' ' ' <"$stack")" >/dev/kmsg
			done
		fi
		size=$now
	done
}
