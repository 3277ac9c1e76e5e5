# SPDX-License-Identifier: Apache-2.0
# Loads the modules and describes the camera example's PL to cm_plsim; sourced.
plsim=/sys/kernel/config/cm_plsim

channel() { # name kind [attribute value]...
	folder="$plsim/board/dma/$1"
	mkdir "$folder" && echo "$2" >"$folder/kind"
	shift 2
	while [ $# -gt 1 ]; do
		echo "$2" >"$folder/$1"
		shift 2
	done
}

window() { # name address size doorbell
	folder="$plsim/board/uio/$1"
	mkdir "$folder"
	echo "$2" >"$folder/address"
	echo "$3" >"$folder/size"
	[ -z "$4" ] || echo "$4" >"$folder/doorbell"
}

overlays=/sys/kernel/config/device-tree/overlays

overlay() { # name file
	mkdir "$overlays/$1" && cat "$2" >"$overlays/$1/dtbo" && [ "$(cat "$overlays/$1/status")" = applied ]
}

# a kernel with overlays gets the board from its device tree, another one from configfs, and so a board whose tree is
# that of a chip
board_up() {
	if [ "${CM_VM_STATIC:-}" = configfs ]; then
		# the driver that comes first takes the nodes that both know
		modprobe cm_window
		modprobe uio_pdrv_genirq of_id=fpga-cm,uio
		modprobe -a cm_overlay cm_intc cm_dma cm_icap cm_plsim cm_clock cm_axi_model "$CM_VM_DRIVER" xilinx-pr-decoupler
		board_configfs
	elif modprobe cm_overlay 2>/dev/null && [ -e /proc/device-tree/__symbols__ ]; then
		# the driver that comes first takes the nodes that both know
		modprobe cm_window
		modprobe uio_pdrv_genirq of_id=fpga-cm,uio
		modprobe -a cm_intc cm_dma cm_icap cm_plsim cm_clock xilinx-pr-decoupler
		# the kernel's own driver of the engines, and what stands behind it
		[ "${CM_VM_STATIC:-static}" = static ] || modprobe -a cm_axi_model "${CM_VM_DRIVER:-xilinx_dma}"
		overlay static "/opt/cm/firmware/qemu-virt/${CM_VM_STATIC:-static}.dtbo"
		mkdir -p /lib/firmware/cm/camera
		cp /opt/cm/firmware/qemu-virt/*.dtbo /lib/firmware/cm/camera
	else
		board_configfs
	fi
}

board_configfs() {
	modprobe -a cm_dma cm_icap cm_plsim 2>/dev/null || modprobe -a cm_dma cm_plsim
	mkdir "$plsim/board" || return
	channel camera source frame_length 3072 interval_us 50000
	channel to_pl loopback direction mm2s peer from_pl fifo 4194304
	channel from_pl loopback direction s2mm peer to_pl fifo 4194304
	# the host may give QEMU no processor time for long, and no load is to fail by that
	if [ -d /sys/module/cm_icap ]; then
		channel icap icap idcode 0x03727093 timeout_ms 600000
		channel icap_read readback peer icap
	fi
	window static 0x58001000 0x1000
	window events 0x59001000 0x1000 0x30
	window camera 0x58002000 0x2000
	window camera-events 0x59002000 0x2000 0x1030
	echo 1 >"$plsim/board/live"
}

# every load takes a while that tests can meet, as on a real port
slow_port() {
	for delay in /sys/kernel/debug/cm_plsim/*/icap/delay_us /sys/kernel/debug/cm_axi/icap/delay_us; do
		[ -e "$delay" ] && echo "$CM_VM_LOAD_US" >"$delay"
	done
}
