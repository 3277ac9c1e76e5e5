# SPDX-License-Identifier: Apache-2.0
"""Whether /dev/kvm runs a kernel: in some virtual machines a plain guest never gets anywhere."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from pathlib import Path

from vmboard.arch import AMD64, Arch, host
from vmboard.cache import Cache
from vmboard.kernel import Kernel
from vmboard.progress import say

PATIENCE_S = 20.0
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def there(arch: Arch) -> bool:
    """Whether there is a /dev/kvm for this architecture to try."""
    return arch == host() and os.access("/dev/kvm", os.R_OK | os.W_OK)


def works(cache: Cache, kernel: Kernel) -> bool:
    """Boot the kernel under KVM to its first lines; the answer is kept until the host is started again."""
    if not there(kernel.arch):
        return False
    known = cache.root / f"kvm-{kernel.release}-{BOOT_ID.read_text().strip()}"
    if not known.exists():
        known.write_text("yes" if _boots(kernel) else "no")
        say(f"/dev/kvm runs a plain kernel: {known.read_text()}")
    return known.read_text() == "yes"


def _boots(kernel: Kernel) -> bool:
    with tempfile.TemporaryDirectory() as folder:
        console = Path(folder) / "console"
        with subprocess.Popen(_command(kernel.arch, kernel.image, console), stderr=subprocess.DEVNULL) as process:
            try:
                return _speaks(process, console, time.monotonic() + PATIENCE_S)
            finally:
                process.kill()


def _command(arch: Arch, image: Path, console: Path) -> list[str]:
    board = ["-M", "q35"] if arch == AMD64 else ["-M", "virt,gic-version=host"]
    port = "console=ttyS0 earlyprintk=ttyS0" if arch == AMD64 else "console=ttyAMA0 earlycon"
    return [
        *(arch.qemu, *board, "-cpu", "host", "-accel", "kvm", "-m", "512", "-nodefaults", "-display", "none"),
        *("-no-reboot", "-serial", f"file:{console}", "-kernel", str(image), "-append", f"{port} panic=-1"),
    ]


def _speaks(process: subprocess.Popen[bytes], console: Path, deadline: float) -> bool:
    while time.monotonic() < deadline and process.poll() is None:
        if console.exists() and b"Linux version" in console.read_bytes():
            return True
        time.sleep(0.2)
    return console.exists() and b"Linux version" in console.read_bytes()
