# SPDX-License-Identifier: Apache-2.0
"""The initramfs of Debian's kernel, whose drivers of the disk are modules: loads them and switches over."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from vmboard.cache import Cache
from vmboard.kernel import Kernel
from vmboard.packages import Apt, unpack
from vmboard.payload import closure, read_dependencies
from vmboard.shell import require

DRIVERS = ("virtio_mmio", "virtio_pci", "virtio_blk", "ext4", "crc32c_generic")
SCRIPT = """#!/bin/busybox sh
/bin/busybox mkdir -p /proc /sys /dev /new
/bin/busybox mount -t proc proc /proc
/bin/busybox mount -t sysfs sys /sys
/bin/busybox mount -t devtmpfs dev /dev
while read -r module; do /bin/busybox insmod "/modules/$module"; done < /modules/order
for disk in /sys/block/vd*; do
	serial=$(/bin/busybox cat "$disk/serial")
	[ "$serial" = cm-root ] && /bin/busybox mount -t ext4 "/dev/${disk##*/}" /new
done
init=/usr/sbin/cm-init
for word in $(/bin/busybox cat /proc/cmdline); do
	case $word in
	cm.init=*) init=${word#*=} ;;
	ro) /bin/busybox mount -o remount,ro /new ;;
	esac
done
/bin/busybox mount -o move /dev /new/dev
/bin/busybox umount /sys
/bin/busybox umount /proc
exec /bin/busybox switch_root /new "$init"
"""


def image(cache: Cache, kernel: Kernel) -> Path:
    """The packed initramfs for a stock kernel."""
    require("cpio")
    inputs = [SCRIPT, *DRIVERS, kernel.release, str(kernel.build)]
    return (
        cache.entry(f"initrd-{kernel.arch.label}", inputs, lambda place: _build(cache, kernel, place)) / "initrd.cpio"
    )


def _build(cache: Cache, kernel: Kernel, place: Path) -> None:
    root = place / "root"
    unpack(
        Apt(cache.root, kernel.arch, kernel.arch.suite).download(["busybox-static"], place / "debs"), place / "packages"
    )
    (root / "bin").mkdir(parents=True)
    (root / "modules").mkdir()
    shutil.copy2(place / "packages/usr/bin/busybox", root / "bin/busybox")
    source = kernel.modules / "lib/modules" / kernel.release
    order = closure(read_dependencies(source), DRIVERS)
    for name in order:
        shutil.copy2(source / name, root / "modules" / Path(name).name)
    (root / "modules/order").write_text("".join(f"{Path(name).name}\n" for name in order))
    (root / "init").write_text(SCRIPT)
    (root / "init").chmod(0o755)
    names = "\n".join(str(path.relative_to(root)) for path in sorted(root.rglob("*"))) + "\n"
    with (place / "initrd.cpio").open("wb") as packed:
        subprocess.run(
            ["cpio", "-o", "-H", "newc", "--quiet"], cwd=root, input=names.encode(), stdout=packed, check=True
        )
