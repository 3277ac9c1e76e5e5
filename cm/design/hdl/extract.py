# SPDX-License-Identifier: Apache-2.0
"""Files → modules with their interfaces; each file is read and parsed once, in mixed languages too."""

from __future__ import annotations

import codecs
import re
from collections import ChainMap
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType

from cm.design.hdl.detect import NOTHING_STATED, detect
from cm.design.hdl.errors import HdlError, ModuleNotFound, UnknownParameter
from cm.design.hdl.model import Language, ModuleInfo, Problem, Stated
from cm.design.hdl.usage import Body, Usage
from cm.design.hdl.user_protocols import UserProtocol
from cm.design.hdl.verilog import VerilogReader
from cm.design.hdl.vhdl import VhdlReader
from cm.design.hdl.vhdl_text import VHDL_SUFFIXES
from cm.design.hdl.vivado_attributes import with_buses
from cm.frozen import dataclass, field

_FEW = 8  # most names that a sentence lists
_NO_FILES: Mapping[Path, str] = MappingProxyType({})
_BESIDE = "it lies beside the file that reads it, and is not listed"
_NETLIST = "a file under tcl: can read a netlist"
_PROJECT = "name the files that it is made of"
_NO_HDL = {
    **dict.fromkeys((".xdc", ".sdc"), "write it under constraints:"),
    ".tcl": "write it under tcl:",
    **dict.fromkeys((".mem", ".hex", ".coe", ".mif", ".dat"), _BESIDE),
    **dict.fromkeys((".dcp", ".edf", ".edn", ".edif", ".ngc"), _NETLIST),
    ".hwh": "it describes a whole design: cm import takes it, and register_map: its registers",
    **dict.fromkeys((".xpr", ".bd", ".xsa", ".hdf"), _PROJECT),
    **dict.fromkeys((".md", ".txt", ".yaml", ".yml"), "leave it out"),
}
_ENCRYPTED = re.compile(r"(?:`|pragma\s+)protect\s+begin_protected", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Sources:
    """HDL to be read, as the build schema has it: `top` alone, or all modules of `files`.

    `defines` are Verilog macros; `parameters` are set on `top`, or on the modules that have them; `libraries`: VHDL
    beside `files`; `interface_parameters`: by port, of SystemVerilog interfaces; `stated`: of clocks and resets;
    `described`: what a component.xml says of the same module, whose buses go before names.
    """

    files: Sequence[Path]
    top: str | None = None
    include_dirs: Sequence[Path] = ()
    defines: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, str] = field(default_factory=dict)
    protocols: Sequence[UserProtocol] = ()
    libraries: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    interface_parameters: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    stated: Stated = NOTHING_STATED
    described: ModuleInfo | None = None

    @property
    def paths(self) -> list[Path]:
        """All files, those of libraries first."""
        return [*(path for paths in self.libraries.values() for path in paths), *self.files]


@dataclass(frozen=True, slots=True)
class Reading:
    """All modules asked for, and the problems of files that declare none of them.

    `outside`: what the modules instantiate, at any depth, that no file declares (known for Verilog only); `files`:
    by module, its file, those of what it instantiates, and those of their languages without a module, such as packages
    and macros, in order.
    """

    modules: tuple[ModuleInfo, ...]
    problems: tuple[Problem, ...]
    outside: tuple[str, ...]
    files: Mapping[str, tuple[Path, ...]]


def read(wanted: Sources, generated: Mapping[Path, str] = _NO_FILES, *, roots: bool = False) -> Reading:
    """Return the modules in the order of the files, with their interfaces; `generated`: text of files not yet written.

    `roots`: without a top, only the modules that no other one instantiates; all where each is instantiated. Several
    folders may declare one module (exports of one tool, each with its own copy of what they share): each module sees
    the units of its own folder before those of others.

    Raises `HdlError` for files that cannot be read or hold no module, `ModuleNotFound` for `top`,
    `ParserMissing` if a parser is not installed. A module's `problems` say what is wrong inside it.
    """
    paths = wanted.paths
    # Headers are often listed among the sources: their folders are searched last.
    files = _Files(list(dict.fromkeys([*wanted.include_dirs, *(path.parent for path in paths)])), wanted.defines)
    for path in paths:
        files.add(path, _read_text(path))
    for path, text in generated.items():
        files.add(path, text)
    found = files.evaluate(files.chosen(wanted.top, roots), wanted.parameters)
    usage = Usage(files.body)
    marked = [with_buses(module, wanted.described) if wanted.described else module for module in found]
    modules = [detect(module, wanted.protocols, wanted.stated, partial(usage.of, module.name)) for module in marked]
    _check_parameters(modules, wanted.parameters)
    names = [module.name for module in modules]
    problems = (*files.problems, *files.hollow(names))
    return Reading(tuple(modules), problems, files.outside(names), {n: files.needs(n) for n in names})


class _Files:
    """The files of both languages, and the file of each module."""

    def __init__(self, include_dirs: Sequence[Path], defines: Mapping[str, str]) -> None:
        self._include_dirs = include_dirs
        self._defines = defines
        self._verilog: VerilogReader | None = None
        self._vhdl: VhdlReader | None = None
        self._found: dict[str, tuple[Language, Path]] = {}
        self._homes: dict[str, dict[Path, Path]] = {}  # by name in lower case: folder → file, the first one first
        self._below: dict[str, tuple[str, ...]] = {}
        self._vhdl_below: dict[str, tuple[str, ...]] = {}  # searched, not parsed: too vague to report one as missing
        self._instantiated: set[str] = set()  # in lower case, by another module, of whichever file
        self._shared: dict[bool, set[Path]] = {}  # by whether they are VHDL: files without modules, or with interfaces
        self._paths: dict[Path, int] = {}  # and their places in the order
        self._errors: dict[Path, tuple[Problem, ...]] = {}  # of files with modules
        self._hollow: dict[str, Problem] = {}
        self.problems: list[Problem] = []

    def add(self, path: Path, text: str) -> None:
        self._paths.setdefault(path, len(self._paths))
        if _ENCRYPTED.search(text):
            what = "parts of this file are encrypted (`protect) and cannot be read: a component.xml describes more"
            self.problems.append(Problem(what, str(path)))
        if _is_vhdl(path):
            self._vhdl = self._vhdl or VhdlReader()
            entities = self._vhdl.parse(path, text)
            self._register([(entity.name, ()) for entity in entities], Language.VHDL, path)
            for entity in entities:
                self._vhdl_below.setdefault(entity.name.lower(), entity.instantiates)
                self._use(entity.name, entity.instantiates)
            if not entities:
                self._shared.setdefault(True, set()).add(path)
            if not entities and "package" not in text.lower():
                self.problems.append(Problem("no entity in this file", str(path)))
            return
        self._verilog = self._verilog or VerilogReader(self._include_dirs, self._defines)
        tree = self._verilog.parse(path, text)
        self._register(tree.modules, tree.language, path)
        if tree.interfaces or not tree.modules:
            self._shared.setdefault(False, set()).add(path)
        self._below |= {name.lower(): () for name in tree.interfaces}
        for name, line in tree.hollow:
            what = "nothing drives its outputs: a black box is 0 in simulation, and empty unless vendor IP fills it"
            self._hollow.setdefault(name.lower(), Problem(f"module {name} has nothing inside: {what}", str(path), line))
        if tree.modules:
            self._errors[path] = tree.errors
        else:
            self.problems.extend(tree.errors)

    def _register(self, units: Iterable[tuple[str, tuple[str, ...]]], language: Language, path: Path) -> None:
        for name, below in units:
            self._use(name, below)
            self._homes.setdefault(name.lower(), {}).setdefault(path.parent, path)
            if name in self._found:
                first = self._found[name][1]
                text = f"module {name} is declared in {first} too: the first one is taken here, synthesis may take this"
                self.problems.append(Problem(text, str(path)))
            else:
                self._found[name] = (language, path)
                self._below[name.lower()] = below

    def _use(self, name: str, below: Iterable[str]) -> None:
        self._instantiated |= {other.lower() for other in below} - {name.lower()}

    def body(self, module: str) -> tuple[Body, tuple[str, ...]] | None:
        """What a module or an entity does itself, and its ports; None if it is in no file."""
        found = self._verilog.body(module) if self._verilog else None
        return found if found or self._vhdl is None else self._vhdl.body(module)

    def hollow(self, modules: Sequence[str]) -> list[Problem]:
        """What `modules` instantiate, at any depth, and that has nothing inside."""
        own = {name.lower() for name in modules}
        return [self._hollow[name] for name in self._reached(modules)[0] if name in self._hollow and name not in own]

    def outside(self, modules: Iterable[str]) -> tuple[str, ...]:
        """What `modules` instantiate, at any depth, that no file declares; VHDL entities match in any case."""
        return tuple(sorted(self._reached(modules)[1].values()))

    def needs(self, module: str) -> tuple[Path, ...]:
        """The files that synthesis of `module` needs; of several that declare one module, that in its own folder."""
        own = self._found[module][1].parent
        reached = self._reached([module], ChainMap(self._vhdl_below, self._below))[0]
        homes = {
            self._homes[name].get(own) or next(iter(self._homes[name].values()))
            for name in reached
            if name in self._homes
        }
        shared = (self._shared.get(kind, ()) for kind in {_is_vhdl(path) for path in homes})
        return tuple(sorted(homes.union(*shared), key=self._paths.__getitem__))

    def _reached(
        self, modules: Iterable[str], below: Mapping[str, tuple[str, ...]] | None = None
    ) -> tuple[dict[str, None], dict[str, str]]:
        """All that `modules` instantiate, in lower case, and of that what no file declares, as it is spelled."""
        below = self._below if below is None else below
        found: dict[str, str] = {}
        seen: dict[str, None] = {}
        todo = list(modules)
        while todo:
            name = todo.pop()
            if name.lower() in seen:
                continue
            seen[name.lower()] = None
            if name.lower() in below:
                todo += below[name.lower()]
            else:
                found[name.lower()] = name
        return seen, found

    def chosen(self, top: str | None, roots: bool) -> list[str]:
        """`top`, or all modules, or all `roots`. Raises `HdlError` where there are none."""
        if not self._found:
            detail = "; ".join(str(problem) for problem in self.problems[:3])
            raise HdlError(f"no module and no entity in {_few(self._paths)}{': ' + detail if detail else ''}")
        if top is None:
            free = [name for name in self._found if name.lower() not in self._instantiated] if roots else []
            return free or list(self._found)
        name = self._name(top)
        if name is None:
            raise ModuleNotFound(f"no module {top} in {_few(self._paths)}; there are: {_few(self._found)}")
        return [name]

    def _name(self, top: str) -> str | None:
        """Find a module's name: Verilog's exactly, VHDL's regardless of case."""
        if top in self._found:
            return top
        vhdl = [name for name, (language, _) in self._found.items() if language is Language.VHDL]
        return next((name for name in vhdl if name.lower() == top.lower()), None)

    def evaluate(self, wanted: Sequence[str], parameters: Mapping[str, str]) -> list[ModuleInfo]:
        vhdl = [name for name in wanted if self._found[name][0] is Language.VHDL]
        verilog = [name for name in wanted if self._found[name][0] is not Language.VHDL]
        below = self.needs(verilog[0]) if len(verilog) == 1 else ()
        modules = self._verilog.read(verilog, parameters, below) if self._verilog else []
        modules += self._vhdl.read(vhdl, parameters) if self._vhdl else []
        asked = {self._found[name][1] for name in wanted}
        self.problems += [error for path, errors in self._errors.items() if path not in asked for error in errors]
        order = {name: number for number, name in enumerate(self._found)}
        return sorted(modules, key=lambda module: order[module.name])


def _is_vhdl(path: Path) -> bool:
    return path.suffix.lower() in VHDL_SUFFIXES


def _few(names: Iterable[object]) -> str:
    """List names for a sentence; of many, only the first."""
    listed = [str(name) for name in names]
    return ", ".join(listed[:_FEW]) + (f" and {len(listed) - _FEW} more" if len(listed) > _FEW else "")


def _read_text(path: Path) -> str:
    try:
        if path.suffix.lower() in _NO_HDL:
            raise HdlError(f"{path} is no HDL: {_NO_HDL[path.suffix.lower()]}")
        data = path.read_bytes()
    except IsADirectoryError:
        raise HdlError(f"{path} is a folder: name the files in it ({path}/*)") from None
    except OSError as error:
        raise HdlError(f"{path}: cannot be read: {error.strerror}") from error
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise HdlError(f"{path} is UTF-16 text: save it as UTF-8")
    return data.decode("utf-8-sig", errors="replace")


def _check_parameters(modules: Sequence[ModuleInfo], parameters: Mapping[str, str]) -> None:
    known = {p.name: module for module in modules for p in module.parameters if not p.local}
    anyhow = {name.lower() for name, module in known.items() if module.language is Language.VHDL}
    for name in parameters:
        if name not in known and name.lower() not in anyhow:
            text = (
                f"no parameter {name} in {', '.join(m.name for m in modules)}; there are: {', '.join(known) or 'none'}"
            )
            raise UnknownParameter(name, text)
