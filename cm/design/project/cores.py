# SPDX-License-Identifier: Apache-2.0
"""Modules whose files are listed in a FuseSoC core."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.project.fusesoc import core_files
from cm.design.project.model import ModuleSpec


def with_core(module: ModuleSpec, path: Path, target: str, roots: Iterable[Path], named: bool) -> ModuleSpec:
    """Return `module` with the core's files before its own; values in the build schema take precedence.

    `named`: the build schema names the top. Raises BuildError for what the core lacks.
    """
    found = core_files(path, target, roots)
    if found.missing:
        raise BuildError("; ".join(found.missing))
    libraries = {name: tuple(files) for name, files in found.libraries.items()}
    for name, files in module.libraries.items():
        libraries[name] = (*libraries.get(name, ()), *files)
    return replace(
        module,
        top=module.top if named or found.top is None else found.top,
        sources=(*found.sources, *module.sources),
        libraries=libraries,
        include_dirs=(*found.include_dirs, *module.include_dirs),
        constraints=(*found.constraints, *module.constraints),
        tcl=(*found.tcl, *module.tcl),
        ip=(*found.ip, *module.ip),
        defines={**found.defines, **module.defines},
        parameters={**found.parameters, **module.parameters},
    )
