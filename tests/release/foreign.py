# SPDX-License-Identifier: Apache-2.0
"""Debian's Python of another architecture under QEMU's user-mode emulation, with a wheel of ours beside it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "vm"))

from vmboard.arch import ARM64, ARMHF, Arch
from vmboard.cache import Cache, default_root
from vmboard.packages import Apt, unpack

ARCHES = {"aarch64": ARM64, "armv7l": ARMHF}
EMULATORS = {"aarch64": "qemu-aarch64", "armv7l": "qemu-arm"}
PACKAGES = ["python3-cffi-backend", "python3-fastjsonschema", "python3-numpy", "python3-pil", "python3-protobuf"]
PACKAGES += ["python3-yaml", "python3-zmq"]
# The emulated Python starts others as itself; the kernel can run a script, but not a program of that architecture.
SCRIPT = """#!/bin/sh
export PYTHONSAFEPATH=1 PYTHONDONTWRITEBYTECODE=1
export PYTHONHOME={root}/usr PYTHONPATH={wheel}:{root}/usr/lib/python3/dist-packages
exec {emulator} -L {root} -0 {script} {python} "$@"
"""


@dataclass(frozen=True, slots=True)
class Python:
    """An interpreter that one can call like any other."""

    script: Path
    release: str

    def run(self, *arguments: str) -> str:
        """Its output; an error is a failure."""
        done = subprocess.run([self.script, *arguments], capture_output=True, text=True, check=False, timeout=600)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


def emulator(machine: str) -> str | None:
    """Where the emulator of a wheel's machine is."""
    return shutil.which(EMULATORS[machine])


def python(machine: str, wheel: Path, folder: Path) -> Python:
    """Make one for a machine, with the wheel's content in front of its own modules."""
    arch = ARCHES[machine]
    root = Cache(default_root()).entry(f"user-{arch.label}", [arch.label, *PACKAGES], lambda out: _unpack(arch, out))
    program = next(path for path in sorted((root / "usr/bin").glob("python3.*")) if path.name[-1].isdigit())
    shutil.unpack_archive(wheel, folder / "wheel", "zip")
    script = folder / "python3"
    names = {"root": root, "wheel": folder / "wheel", "emulator": emulator(machine), "script": script}
    script.write_text(SCRIPT.format(**names, python=program))
    script.chmod(0o755)
    return Python(script, arch.suite or "the host's")


def _unpack(arch: Arch, place: Path) -> None:
    cache = default_root()
    unpack(Apt(cache, arch, arch.suite).closure(PACKAGES, place / "debs"), place)
    shutil.rmtree(place / "debs")
    for name in ("blas", "lapack"):  # update-alternatives would
        link = place / "usr/lib" / arch.gnu / f"lib{name}.so.3"
        if not os.path.lexists(link):
            link.symlink_to(f"{name}/lib{name}.so.3")
