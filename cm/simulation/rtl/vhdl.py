# SPDX-License-Identifier: Apache-2.0
"""Modules in VHDL as Verilog, by ghdl's synthesis, with their generics set."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from cm.design.project.model import ModuleSpec
from cm.simulation.rtl.cache import cache_folder, digest, made
from cm.simulation.rtl.errors import RtlError, ToolMissing

_FLAGS = ("--std=08", "-fsynopsys", "-frelaxed")  # 2008 reads what is older, but for a few shared variables


def as_verilog(module: ModuleSpec, work: tuple[Path, ...]) -> Path:
    """One file, whose module has the entity's name; `work`: the files of library ``work``.

    Raises ToolMissing without ghdl, RtlError with what it says about the HDL.
    """
    ghdl = shutil.which(os.environ.get("CM_GHDL", "ghdl"))
    if ghdl is None:
        raise ToolMissing(f"of module {module.name} needs ghdl, as it is VHDL: apt-get install ghdl")
    libraries = {**module.libraries, "work": (*module.libraries.get("work", ()), *work)}
    generics = [f"-g{name}={_value(value)}" for name, value in sorted(module.parameters.items())]
    version = _run([ghdl, "--version"], Path.cwd(), module.name)
    names = [f"{library} {len(files)}" for library, files in libraries.items()]
    texts = [file.read_bytes() for files in libraries.values() for file in files]
    key = digest([version, module.top, *_FLAGS, *generics, *names, *texts])

    def make(target: Path, scratch: Path) -> None:
        target.write_text(_synthesise(ghdl, module, libraries, generics, scratch), encoding="utf-8")

    return made(cache_folder(), f"vhdl-{key}.v", make)


def _synthesise(
    ghdl: str, module: ModuleSpec, libraries: Mapping[str, tuple[Path, ...]], generics: list[str], scratch: Path
) -> str:
    places = [f"--workdir={scratch}", f"-P{scratch}"]
    for library, files in libraries.items():
        if files:
            _run([ghdl, "-i", *_FLAGS, *places, f"--work={library}", *map(str, files)], scratch, module.name)
    # brings the units into their order; what it says of generics without a value is not an error here
    subprocess.run([ghdl, "-m", *_FLAGS, *places, module.top], cwd=scratch, capture_output=True, check=False)
    return _run([ghdl, "--synth", *_FLAGS, *places, "--out=verilog", *generics, module.top], scratch, module.name)


def _value(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _run(command: list[str], folder: Path, module: str) -> str:
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, errors="replace", check=False, stdin=subprocess.DEVNULL
    )
    if done.returncode:
        said = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        raise RtlError(f"module {module}: ghdl does not synthesise it:\n  " + "\n  ".join(said[:20]))
    return done.stdout
