# SPDX-License-Identifier: Apache-2.0
"""Reads files that describe modules, by kind: HDL, FuseSoC core, IP-XACT component, IP instance.

`cm build init` and `cm build interfaces` are given any of them, together.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design import hdl
from cm.design.compile_order import compile_order
from cm.design.errors import BuildError
from cm.design.hdl.errors import ModuleNotFound
from cm.design.hdl.flat import Wanted, needs_wrapper
from cm.design.hdl.flatten import flatten
from cm.design.hdl.hls_registers import HDL
from cm.design.hdl.ipxact import component_files
from cm.design.hdl.model import ModuleInfo, Problem
from cm.design.hdl.protocols import UserProtocol
from cm.design.hdl.register_maps import read_register_map
from cm.design.project.fusesoc import core_files

CPP = (".cpp", ".cc", ".cxx", ".c")
_EMPTY: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Given:
    """A module, the keys that a build schema needs for it, and the files that were read with it."""

    info: ModuleInfo
    keys: Mapping[str, Any] = field(default_factory=lambda: _EMPTY)
    files: tuple[Path, ...] = ()

    @property
    def flat(self) -> ModuleInfo:
        """The module with the ports of its flat wrapper, if it needs one, under its own name."""
        if not needs_wrapper(self.info) or not self.files:
            return self.info
        wanted = Wanted(self.info.name, self.files, {}, [], {}, {}, {})
        return replace(flatten(self.info, wanted)[0], name=self.info.name)


@dataclass(frozen=True, slots=True)
class Options:
    """How to read: only the module `top`, or `every` one, else those that no other instantiates.

    `keys`: what a build schema in `folder` needs is found too. `cores`: where to look for what a core depends on.
    """

    top: str | None = None
    every: bool = False
    keys: bool = False
    folder: Path = Path()
    cores: Sequence[Path] = ()
    include_dirs: Sequence[Path] = ()
    defines: Mapping[str, str] = field(default_factory=lambda: _EMPTY)
    parameters: Mapping[str, str] = field(default_factory=lambda: _EMPTY)
    protocols: Sequence[UserProtocol] = ()

    def path(self, path: Path) -> str:
        """Return `path` as a build schema in `folder` would name it."""
        return Path(os.path.relpath(path.absolute(), self.folder.absolute())).as_posix()


def read_inputs(files: Sequence[Path], options: Options) -> tuple[list[Given], Sequence[Problem]]:
    """Return the modules of all files, those of HDL first, and the problems of files without any."""
    sources = [path for path in files if path.suffix.lower() not in (".core", ".xml", ".xci", *CPP)]
    found: list[Given] = []
    problems: Sequence[Problem] = ()
    try:
        if sources:
            found, problems = _of_hdl(sources, options)
    except ModuleNotFound:
        if len(sources) == len(files):
            raise
    for path in files:
        suffix = path.suffix.lower()
        if suffix == ".core":
            found += _of_core(path, options)
        elif suffix == ".xml":
            found.append(_of_component(path, options))
        elif suffix == ".xci":
            found.append(Given(hdl.load_xci(path, options.protocols), {"ip": [options.path(path)]}))
        elif suffix in CPP:
            what = "C++ says nothing of ports and registers before it is synthesised"
            raise BuildError(f"{path}: {what}: run Vitis HLS, and give the component.xml or the Verilog that it wrote")
    return found, problems


def _of_hdl(files: Sequence[Path], options: Options) -> tuple[list[Given], Sequence[Problem]]:
    how = (options.include_dirs, options.defines)
    reading = hdl.read(files, options.top, *how, options.parameters, options.protocols)
    modules = reading.modules if options.top or options.every else hdl.roots(reading.modules)
    if not options.keys:
        return [Given(info) for info in modules], reading.problems
    twice = {Path(problem.file) for problem in reading.problems if " is declared in " in problem.message}
    folders = list(dict.fromkeys(path.parent for path in files))
    if twice and len(folders) > 1:  # exports of one tool, each with its own copy of what they share
        return _by_folder(files, folders, options), reading.problems
    known = reading.modules if options.top is None else hdl.read(files, None, *how).modules
    return [Given(info, _source_keys(info, known, files, options), tuple(files)) for info in modules], reading.problems


def _by_folder(files: Sequence[Path], folders: Sequence[Path], options: Options) -> list[Given]:
    """The modules of each folder with its own files first; those that another folder's module instantiates are none."""
    found: dict[str, Given] = {}
    below: set[str] = set()
    for folder in folders:
        mine = sorted(files, key=lambda path: path.parent != folder)
        reading = hdl.read(mine, options.top, options.include_dirs, options.defines, options.parameters)
        twice = {Path(problem.file) for problem in reading.problems if " is declared in " in problem.message}
        kept = [path for path in mine if path not in twice]
        for info in reading.modules if options.top else hdl.roots(reading.modules):
            if Path(info.file).parent == folder:
                found.setdefault(
                    info.name, Given(info, _source_keys(info, reading.modules, kept, options), tuple(kept))
                )
        below |= {name for info in reading.modules for name in info.instantiates}
    return [given for name, given in found.items() if name not in below or options.top]


def _source_keys(
    info: ModuleInfo, known: Sequence[ModuleInfo], files: Sequence[Path], options: Options
) -> dict[str, Any]:
    """Files of the module and what it instantiates, and those without a module (packages, macros), in order."""
    by_name = {module.name: module for module in known}
    needed = {Path(info.file), *files} - {Path(module.file) for module in known if module.file != info.file}
    queue = [info]
    seen = {info.name}
    for module in queue:
        for name in module.instantiates:
            if name in by_name and name not in seen:
                seen.add(name)
                queue.append(by_name[name])
                needed.add(Path(by_name[name].file))
    sources = compile_order(path for path in files if path in needed)
    return {"sources": [options.path(path) for path in sources], **_register_map(sources, None, options)}


def _register_map(sources: Sequence[Path], component: Path | None, options: Options) -> dict[str, str]:
    """The file that lists the registers: of HLS's own ones the HDL's, then a component, if it has any."""
    own = [path for path in sources if HDL.match(path.name)]
    if len(own) > 1:  # a bus each, whose offsets count from different places
        return {}
    for path in (*own, *([component] if component else [])):
        try:
            if read_register_map(path, ""):
                return {"register_map": options.path(path)}
        except BuildError:
            continue
    return {}


def _of_core(path: Path, options: Options) -> list[Given]:
    listed = core_files(path, roots=options.cores)
    if listed.missing:
        raise BuildError("; ".join(listed.missing))
    files = [*(file for paths in listed.libraries.values() for file in paths), *listed.sources]
    if not files:
        raise BuildError(f"{path}: target default has no Verilog or VHDL")
    parameters = {name: str(value) for name, value in listed.parameters.items()}
    known = hdl.read(files, include_dirs=listed.include_dirs, defines=listed.defines, parameters=parameters).modules
    own = {str(file) for file in listed.own}
    wanted = options.top or listed.top
    mine = [info for info in hdl.roots(known) if info.file in own]
    chosen = [info for info in known if info.name == wanted] if wanted else mine
    keys: dict[str, Any] = {"core": options.path(path)}
    if options.cores:
        keys["core_roots"] = [options.path(root) for root in options.cores]
    return [Given(info, {"top": info.name, **keys}) for info in chosen]


def _of_component(path: Path, options: Options) -> Given:
    info = hdl.load_component_xml(path)
    if not options.keys:
        return Given(info)
    files = component_files(path)
    keys: dict[str, Any] = {"top": info.name, "component": options.path(path)}
    for name, paths in (("sources", files.sources), ("include_dirs", files.include_dirs), ("ip", files.ip),
                        ("constraints", files.constraints), ("tcl", files.tcl)):  # fmt: skip
        if paths:
            keys[name] = [options.path(file) for file in paths]
    if files.libraries:
        keys["libraries"] = {
            library: [options.path(file) for file in paths] for library, paths in files.libraries.items()
        }
    return Given(info, {**keys, **_register_map(files.sources, path, options)})
