# SPDX-License-Identifier: Apache-2.0
"""Vivado on this machine: its path, its version, and excerpts of its logs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cm.design.errors import BuildError, MissingTool

OLDEST = (2020, 1)
_VERSION = re.compile(r"[Vv]ivado v?(20\d\d)\.(\d+)")
_FAILURE = re.compile(
    r"^(ERROR|CRITICAL WARNING|Abnormal program termination|.*\berror: )|^\s+while executing", re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class Vivado:
    """An installation."""

    path: Path
    version: tuple[int, int]

    def __str__(self) -> str:
        return f"Vivado {self.version[0]}.{self.version[1]} ({self.path})"


def find_vivado(setting: str | None, environment: Mapping[str, str], wanted: str | None = None) -> Vivado:
    """Vivado by `setting` (the program, or an installation's folder), by XILINX_VIVADO or by PATH.

    Raises `MissingTool` if there is none, `BuildError` if its version is too old or not the wanted one.
    """
    path = _locate(setting, environment)
    version = _version(path)
    if version < OLDEST:
        raise BuildError(f"{path} is version {version[0]}.{version[1]}; 2020.1 or newer is needed")
    if wanted is not None and wanted != f"{version[0]}.{version[1]}":
        raise BuildError(f"the build schema insists on Vivado {wanted}; {path} is {version[0]}.{version[1]}")
    return Vivado(path, version)


def _locate(setting: str | None, environment: Mapping[str, str]) -> Path:
    for given in (setting, environment.get("XILINX_VIVADO")):
        if not given:
            continue
        path = Path(given)
        program = path / "bin" / "vivado" if path.is_dir() else path
        if program.is_file() and os.access(program, os.X_OK):
            return program.absolute()
        if given is setting:
            raise MissingTool(f"{given} is neither Vivado's program nor the folder of an installation")
    found = shutil.which("vivado", path=environment.get("PATH", ""))
    if found is None:
        raise MissingTool(
            "Vivado was not found: source its settings64.sh, or give --vivado FOLDER. "
            "Everything before this step works without it; `make` in the output folder runs the flow elsewhere"
        )
    return Path(found)


def _version(path: Path) -> tuple[int, int]:
    try:
        said = subprocess.run([path, "-version"], capture_output=True, text=True, timeout=120, check=False).stdout
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BuildError(f"{path} -version failed: {error}") from None
    found = _VERSION.search(said)
    if found is None:
        raise BuildError(f"{path} does not say which version it is: {said[:80]!r}")
    return int(found[1]), int(found[2])


def excerpt(log: Path, most: int = 12) -> list[str]:
    """Return the lines of a log that say what went wrong, or else its last lines."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return [f"(no log at {log})"]
    told = [f"{number}: {line.strip()[:300]}" for number, line in enumerate(lines, 1) if _FAILURE.search(line)]
    errors = [line for line in told if "CRITICAL WARNING" not in line]
    chosen = errors or told or [line[:300] for line in lines if line.strip()]
    return chosen[-most:]
