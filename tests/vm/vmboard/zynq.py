# SPDX-License-Identifier: Apache-2.0
"""QEMU's Zynq-7000 board: which QEMU, its command line, and what comes back from a board without virtio."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from vmboard.arch import ARMHF, host
from vmboard.cache import Cache
from vmboard.errors import MissingError, VmError
from vmboard.kernel import Kernel
from vmboard.packages import Apt, unpack
from vmboard.shell import run

if TYPE_CHECKING:
    from vmboard.qemu import Machine

SUITE, PACKAGE = "sid", "qemu-system-arm"  # no release of Debian has one that is new enough
OLDEST = (11, 1)  # the first whose devcfg can be unlocked
TREES = Path(__file__).resolve().parents[1] / "trees/zynq"
# IOPLL at 1 GHz, as boot loaders leave it, and not the 867 MHz of a reset: SLCR's unlock, IO_PLL_CTRL (UG585)
REGISTERS = ((0xF8000008, 0xDF0D), (0xF8000108, 0x0001E008))


def emulator(cache: Cache) -> list[str]:
    """The start of QEMU's command line: `$CM_VM_QEMU_ARM`, or Debian's newest, kept in the cache.

    Raises MissingError where none is new enough, VmError where it cannot be fetched.
    """
    chosen = os.environ.get("CM_VM_QEMU_ARM")
    start = chosen.split() if chosen else _fetched(cache.entry(PACKAGE, [SUITE], lambda out: _fetch(cache, out)))
    said = run([*start, "--version"])
    found = re.search(r"version (\d+)\.(\d+)", said)
    if found is None or (int(found[1]), int(found[2])) < OLDEST:
        raise MissingError(f"QEMU's Zynq needs version {OLDEST[0]}.{OLDEST[1]}; this is {said.splitlines()[0]!r}")
    return start


def _fetch(cache: Cache, place: Path) -> None:
    unpack(Apt(cache.root, host(), SUITE).closure([PACKAGE], place / "debs"), place / "root")
    shutil.rmtree(place / "debs")


def _fetched(place: Path) -> list[str]:
    """Through the C library that it was built for: the machine's own may be older."""
    libraries = place / "root/usr/lib" / host().gnu
    loader = next(libraries.glob("ld-linux*.so.*"))
    program = place / "root/usr/bin" / ARMHF.qemu
    return [str(loader), "--library-path", str(libraries), str(program), "-L", str(place / "root/usr/share/qemu")]


def tree(cache: Cache, kernel: Kernel) -> Path:
    """The board's tree, on the kernel's own of the chip."""
    source, chip = TREES / "zynq-a9.dts", kernel.build / "source/arch/arm/boot/dts"
    include = kernel.build / "source/include"

    def build(place: Path) -> None:
        expand = ["cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", "-I", chip, "-I", include]
        (place / "zynq-a9.dts").write_text(run([*expand, source]))
        run(["dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", place / "zynq-a9.dtb", place / "zynq-a9.dts"])

    return cache.entry("tree-zynq", [source, chip / "zynq-7000.dtsi"], build) / "zynq-a9.dtb"


def command(machine: Machine, place: Path, consoles: tuple[str, str] | None = None) -> list[str]:
    """The whole command line; the board's second disk is a copy, into which it puts its results.

    `consoles`: where its two UARTs go; files in `place` if None.
    """
    first, second = consoles or (f"file:{place / 'console.log'}", f"file:{place / 'output.log'}")
    shutil.copyfile(machine.payload, place / "payload.ext4")
    append = ["console=ttyPS0,115200", "root=/dev/mmcblk0", "rootwait", "rw", "init=/usr/sbin/cm-init", "panic=-1"]
    append += ["loglevel=6", "printk.time=1", "maxcpus=1", *machine.arguments]
    append += os.environ.get("CM_VM_APPEND", "").split()
    registers = [f"loader,addr={address:#x},data={value:#x},data-len=4" for address, value in REGISTERS]
    return [
        *machine.emulator,
        *("-M", "xilinx-zynq-a9", "-m", str(machine.memory_mb), "-no-reboot", "-display", "none", "-monitor", "none"),
        *("-kernel", str(machine.image), "-dtb", str(machine.dtb), "-append", " ".join(append), "-nic", "none"),
        *("-drive", f"if=sd,index=0,file={machine.root},format=raw,snapshot=on"),
        *("-drive", f"if=sd,index=1,file={place / 'payload.ext4'},format=raw,cache=unsafe"),
        *("-serial", first, "-serial", second),
        *(word for register in registers for word in ("-device", register)),
    ]


def collect(place: Path, results: Path) -> None:
    """What the board left on its second disk."""
    try:
        run(["debugfs", "-R", f"dump /results.tar {results}", place / "payload.ext4"])
    except VmError:
        results.unlink(missing_ok=True)
    (place / "payload.ext4").unlink()
