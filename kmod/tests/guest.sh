# SPDX-License-Identifier: Apache-2.0
# What the guest of run-kvm.sh does; sourced by busybox sh as root.
set -e
cd /modules
for module in configfs uio cm_dma cm_window cm_icap cm_plsim cm_axidma_compat; do
	if [ -e $module.ko ]; then insmod $module.ko; fi
done
mount -t configfs configfs /sys/kernel/config

root=/sys/kernel/config/cm_plsim
board=$root/board
mkdir $board
for name in to_pl from_pl camera display icap icap_read vcam; do mkdir $board/dma/$name; done
echo loopback >$board/dma/to_pl/kind
echo mm2s >$board/dma/to_pl/direction
echo from_pl >$board/dma/to_pl/peer
echo loopback >$board/dma/from_pl/kind
echo s2mm >$board/dma/from_pl/direction
echo to_pl >$board/dma/from_pl/peer
echo 1 >$board/dma/vcam/video
echo 2000 >$board/dma/vcam/interval_us
echo sink >$board/dma/display/kind
echo icap >$board/dma/icap/kind
echo readback >$board/dma/icap_read/kind
echo icap >$board/dma/icap_read/peer
echo 0x03727093 >$board/dma/icap/idcode
mkdir $board/uio/camera
echo 0x43c00000 >$board/uio/camera/address
echo 8192 >$board/uio/camera/size
echo 0x1000 >$board/uio/camera/doorbell
echo 1 >$board/live

# refused while live
! echo sink >$board/dma/camera/kind 2>/dev/null
! mkdir $board/dma/other 2>/dev/null
ls /dev/cm_dma /dev/uio* /dev/cm_icap* 2>/dev/null || true
cat /sys/class/uio/uio0/name /sys/class/uio/uio0/maps/map0/addr /sys/class/uio/uio0/maps/map0/size
engine=/sys/kernel/debug/cm_plsim/$(cat $board/dev_name)
ls $engine /sys/kernel/debug/cm_dma

smoke_dma $engine
for test in uio window icap axidma; do
	if command -v smoke_$test >/dev/null; then smoke_$test $engine; fi
done

# the board goes away under an open file, and comes back
sleep 30 </dev/cm_dma/camera &
sleeper=$!
sleep 0.2
echo 0 >$board/live
kill $sleeper
wait $sleeper || true
for i in 1 2 3 4 5 6 7 8 9 10; do
	echo 1 >$board/live
	test -e /dev/cm_dma/camera
	echo 0 >$board/live
	test ! -e /dev/cm_dma/camera
done
echo 1 >$board/live
for name in to_pl from_pl camera display icap icap_read vcam; do rmdir $board/dma/$name; done
rmdir $board/uio/camera $board
for module in cm_axidma_compat cm_plsim cm_icap cm_window cm_dma; do
	if grep -q "^$module " /proc/modules; then rmmod $module; fi
done
if dmesg | grep -E 'BUG|WARNING|Oops|refcount|leak'; then exit 1; fi
