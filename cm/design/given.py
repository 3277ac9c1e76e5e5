# SPDX-License-Identifier: Apache-2.0
"""Reads what `cm build init` is given, by kind of file: HDL, core, IP-XACT component, IP instance, HLS C++."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design import hdl
from cm.design.errors import BuildError
from cm.design.hdl.hls import load_hls
from cm.design.hdl.ipxact_files import component_files
from cm.design.hdl.model import ModuleInfo
from cm.design.project.fusesoc import core_files
from cm.design.project.model import HlsSpec

HLS_SUFFIXES = (".cpp", ".cc", ".cxx")
_OTHER = (".core", ".xml", ".xci", *HLS_SUFFIXES)


@dataclass(frozen=True, slots=True)
class Given:
    """Modules that could go into a region, each with the keys that a build schema needs for it."""

    info: ModuleInfo
    keys: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))


def is_hdl(path: Path) -> bool:
    """Whether a file is read as HDL: every suffix that has no other reader."""
    return path.suffix.lower() not in _OTHER


def others(files: Iterable[Path], folder: Path, cores: Sequence[Path], top: str | None) -> list[Given]:
    """The modules of files that are not HDL; paths in keys are relative to `folder`."""
    found: list[Given] = []
    for path in files:
        suffix = path.suffix.lower()
        if suffix == ".core":
            found += _core(path, folder, cores, top)
        elif suffix == ".xml":
            found.append(_component(path, folder))
        elif suffix == ".xci":
            found.append(Given(hdl.load_xci(path), {"ip": [relative(path, folder)]}))
        elif suffix in HLS_SUFFIXES:
            spec = HlsSpec((path,))
            info = load_hls(spec, top)
            found.append(Given(info, {"top": info.name, "hls": {"sources": [relative(path, folder)]}}))
    return found


def _core(path: Path, folder: Path, cores: Sequence[Path], top: str | None) -> list[Given]:
    listed = core_files(path, roots=cores)
    if listed.missing:
        raise BuildError("; ".join(listed.missing))
    files = [*(file for paths in listed.libraries.values() for file in paths), *listed.sources]
    if not files:
        raise BuildError(f"{path}: target default has no Verilog or VHDL")
    parameters = {name: str(value) for name, value in listed.parameters.items()}
    known = hdl.read(files, include_dirs=listed.include_dirs, defines=listed.defines, parameters=parameters).modules
    own = {str(file) for file in listed.own}
    wanted = top or listed.top
    mine = [info for info in hdl.roots(known) if info.file in own]
    chosen = [info for info in known if info.name == wanted] if wanted else mine
    keys: dict[str, Any] = {"core": relative(path, folder)}
    if cores:
        keys["core_roots"] = [relative(root, folder) for root in cores]
    return [Given(info, {"top": info.name, **keys}) for info in chosen]


def _component(path: Path, folder: Path) -> Given:
    info = hdl.load_component_xml(path)
    files = component_files(path)
    keys: dict[str, Any] = {"top": info.name, "component": relative(path, folder)}
    for name, paths in (("sources", files.sources), ("include_dirs", files.include_dirs), ("ip", files.ip),
                        ("constraints", files.constraints), ("tcl", files.tcl)):  # fmt: skip
        if paths:
            keys[name] = [relative(file, folder) for file in paths]
    if files.libraries:
        keys["libraries"] = {
            library: [relative(file, folder) for file in paths] for library, paths in files.libraries.items()
        }
    return Given(info, keys)


def relative(path: Path, folder: Path) -> str:
    """Return `path` as a build schema in `folder` would name it."""
    return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
