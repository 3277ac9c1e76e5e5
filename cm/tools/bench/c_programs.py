# SPDX-License-Identifier: Apache-2.0
"""The C programs of the bench, compiled here and now (cm/tools/bench/c)."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from importlib import resources
from pathlib import Path

from cm.errors import CmError
from cm.tools.bench.peer import Unavailable

FLAGS = ("-O2", "-Wall", "-std=gnu11")


class CannotCompile(CmError):
    """There is a compiler, but it fails."""

    code = "cannot_compile"


def compiler() -> list[str]:
    """``$CC`` or ``cc``. Raises Unavailable."""
    words = shlex.split(os.environ.get("CC", "cc"))
    if shutil.which(words[0]) is None:
        raise Unavailable(f"not available: no C compiler ({words[0]})")
    return words


def uapi() -> Path:
    """The folder of the interface's headers, which the source tree has. Raises Unavailable."""
    folder = Path(__file__).resolve().parents[3] / "kmod" / "uapi"
    if not (folder / "cm_node.h").exists():
        raise Unavailable("not available: kmod/uapi is in the source tree only; run the bench there")
    return folder


def build(folder: Path, name: str, *flags: str) -> Path:
    """Compile ``c/<name>.c`` into `folder`. Raises Unavailable, CannotCompile."""
    program = folder / name
    with resources.as_file(resources.files("cm.tools.bench").joinpath(f"c/{name}.c")) as source:
        command = [*compiler(), *FLAGS, *flags, "-o", str(program), str(source)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CannotCompile(f"{shlex.join(command)}: {done.stderr.strip()}")
    return program


class Copies:
    """``copies.c``, running with frames of `size` bytes; it times its trips itself."""

    def __init__(self, folder: Path, size: int) -> None:
        self._process = subprocess.Popen(
            [str(build(folder, "copies")), str(size)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def batch(self, trips: int) -> tuple[float, ...]:
        """Durations of that many trips, µs."""
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(f"{trips}\n")
        stdin.flush()
        return tuple(int(stdout.readline()) / 1e3 for _ in range(trips))

    def __enter__(self) -> Copies:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()


class TimedPort:
    """``port.c``: a configuration port at ``dev/cm_icap0`` of `root` that takes the time of each load's arrival."""

    def __init__(self, root: Path) -> None:
        program = build(root, "port", f"-I{uapi()}")
        (root / "dev").mkdir()
        self._process = subprocess.Popen([str(program), str(root / "dev" / "cm_icap0")], stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def __enter__(self) -> TimedPort:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()
