# SPDX-License-Identifier: Apache-2.0
"""Running programs of the host, with their output kept for the one who has to look."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from vmboard.errors import MissingError, VmError

Argument = str | Path
PACKAGES = {  # of Debian, where they are called otherwise than the program
    "depmod": "kmod",
    "dpkg-deb": "dpkg",
    "dtc": "device-tree-compiler",
    "mke2fs": "e2fsprogs",
    "protoc": "protobuf-compiler",
    "qemu-system-aarch64": "qemu-system-arm",
    "qemu-system-x86_64": "qemu-system-x86",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu",
    "arm-linux-gnueabihf-gcc": "gcc-arm-linux-gnueabihf",
}


def require(*programs: str) -> None:
    """Raise MissingError naming every program that is not on the PATH."""
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        packages = " ".join(sorted({PACKAGES.get(name, name) for name in missing}))
        names = ", ".join(missing)
        raise MissingError(f"not installed: {names} (apt install {packages}; tests/vm/packages.txt has all)")


def run(
    command: Sequence[Argument],
    *,
    cwd: Path | None = None,
    log: Path | None = None,
    env: Mapping[str, str] | None = None,
) -> str:
    """Run a program and return its standard output, or append all output to `log`.

    Raises VmError where it fails, MissingError where it is not there.
    """
    arguments = [str(argument) for argument in command]
    require(arguments[0])
    environment = None if env is None else {**os.environ, **env}
    if log is None:
        done = subprocess.run(arguments, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
        output, errors = done.stdout, done.stderr
    else:
        with log.open("ab") as stream:
            done = subprocess.run(
                arguments, cwd=cwd, env=environment, stdout=stream, stderr=stream, text=True, check=False
            )
        output, errors = "", "\n".join(log.read_text(errors="replace").splitlines()[-25:])
    if done.returncode:
        where = "" if log is None else f", log {log}"
        raise VmError(f"{arguments[0]} failed with status {done.returncode}{where}: {' '.join(arguments)}\n{errors}")
    return output
