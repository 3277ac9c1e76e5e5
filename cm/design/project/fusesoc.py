# SPDX-License-Identifier: Apache-2.0
"""FuseSoC core files (`.core`, CAPI2) → the files of a target, with those of the cores that it depends on.

They are read as FuseSoC does (its user guide, "CAPI2 reference"): `filesets` of a target in order, those of
dependencies first; `_append` keys; `flag ? (…)` and `!flag ? (…)` in names, with the flags that
`tool: vivado` sets. Dependencies are looked for below given folders; nothing is fetched, and no generator is run.

Modules whose files are listed in a FuseSoC core.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from cm.design.errors import BuildError
from cm.design.project.model import ModuleSpec
from cm.frozen import dataclass, field, replace

_TOKEN = re.compile(r"\s*(?:(!?)([\w+-]+)\s*\?\s*\(|(\))|([^\s()]+))")
_RELATION = re.compile(r"(>=|<=|>|<|=|~|\^)?(.*)")
_HDL = ("verilogSource", "systemVerilogSource", "vhdlSource")
_LIMIT = 1 << 20  # bytes; real files have some KiB


@dataclass(slots=True)
class CoreFiles:
    """The files of a target, dependencies first; `missing`: sentences about what does not exist."""

    sources: list[Path] = field(default_factory=list)
    libraries: dict[str, list[Path]] = field(default_factory=dict)
    include_dirs: list[Path] = field(default_factory=list)
    constraints: list[Path] = field(default_factory=list)
    tcl: list[Path] = field(default_factory=list)
    ip: list[Path] = field(default_factory=list)
    defines: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, int | float | str | bool] = field(default_factory=dict)
    own: list[Path] = field(default_factory=list)  # sources of the core itself
    top: str | None = None
    missing: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class _Core:
    path: Path
    name: str  # vendor:library:name
    version: tuple[int, ...]
    data: Mapping[str, Any]


def core_files(path: Path, target: str = "default", roots: Iterable[Path] = ()) -> CoreFiles:
    """Return the files of a core's target. Raises BuildError if it is not a core file or has no such target."""
    core = _read(path)
    targets = core.data.get("targets") or {}
    if target not in targets:
        raise BuildError(f"{path}: no target {target}; there are: {', '.join(map(str, targets)) or 'none'}")
    reader = _Reader(target, [path.parent, *roots])
    try:
        reader.add(core, target, top=True)
    except (AttributeError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise BuildError(f"{path}: not as CAPI2 has it, or a core that it depends on is not: {error}") from None
    return reader.found


def _read(path: Path) -> _Core:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise BuildError(f"{path}: cannot be read: {error.strerror}") from None
    first, _, rest = raw[:_LIMIT].decode("utf-8", errors="replace").partition("\n")
    if len(raw) > _LIMIT or not re.fullmatch(r"CAPI\s*=\s*2\s*:?\s*", first.lstrip("\ufeff")):
        what = "a CAPI1 core, which FuseSoC 2 does not read either" if "[main]" in rest else "not a FuseSoC core file"
        raise BuildError(f"{path}: {what}: the first line is not CAPI=2:")
    try:
        data = yaml.safe_load(rest)
    except yaml.YAMLError as error:
        raise BuildError(f"{path}: {' '.join(str(error).split())}") from None
    if not isinstance(data, dict) or not isinstance(data.get("name"), str):
        raise BuildError(f"{path}: not a FuseSoC core file: it has no name:")
    name, version = _vlnv(data["name"])
    return _Core(path, name, version, data)


def _vlnv(text: str) -> tuple[str, tuple[int, ...]]:
    """Split a VLNV into ``vendor:library:name`` and the version as numbers, 0 if there is none."""
    parts = text.strip().split(":")
    if len(parts) == 1:
        parts = ["", "", *parts]
    elif len(parts) == 2:
        parts = ["", *parts]
    numbers = tuple(int(number) for number in re.findall(r"\d+", ":".join(parts[3:]))) or (0,)
    return ":".join(parts[:3]), numbers


def names(text: object, flags: frozenset[str]) -> list[str]:
    """The words of an expression that apply under `flags`."""
    found: list[str] = []
    holds = [True]
    for negated, flag, closing, word in _TOKEN.findall(str(text)):
        if flag:
            holds.append(holds[-1] and (flag in flags) != bool(negated))
        elif closing:
            holds = holds[:-1] or [True]
        elif holds[-1]:
            found.append(word)
    return found


class _Reader:
    def __init__(self, target: str, roots: Sequence[Path]) -> None:
        self.found = CoreFiles()
        self._target = target
        self._roots = roots
        self._known: dict[str, list[_Core]] | None = None
        self._seen: set[str] = set()

    def add(self, core: _Core, name: str, *, top: bool = False) -> None:
        """Add a core's target, after its dependencies."""
        if core.name in self._seen:
            return
        self._seen.add(core.name)
        target = (core.data.get("targets") or {}).get(name) or {}
        flags = {"tool_vivado", f"target_{self._target}"} | ({"is_toplevel"} if top else set())
        flags |= {flag for flag, value in (target.get("flags") or {}).items() if value}
        fixed = frozenset(flags)
        if target.get("generate") or target.get("generate_append"):
            self.found.missing.append(
                f"{core.path}: target {name} has generators: run them with fusesoc, name the files"
            )
        sets = core.data.get("filesets") or {}
        chosen = [n for entry in _both(target, "filesets") for n in names(entry, fixed)]
        unknown = [n for n in chosen if n not in sets]
        if unknown:
            raise BuildError(f"{core.path}: target {name} has no fileset {', '.join(unknown)}")
        for fileset in chosen:
            for entry in _both(sets[fileset], "depend"):
                for wanted in names(entry, fixed):
                    self._depend(core, wanted)
        for fileset in chosen:
            self._files(core, sets[fileset], fixed, top)
        if top:
            tops = target.get("toplevel")
            self.found.top = next(iter(tops if isinstance(tops, list) else names(tops or "", fixed)), None)
        self._parameters(core, target, fixed)

    def _depend(self, core: _Core, wanted: str) -> None:
        match = _RELATION.fullmatch(wanted)
        relation, (name, version) = (match[1] or "=", _vlnv(match[2])) if match else ("=", (wanted, (0,)))
        if name in self._seen:
            return
        candidates = self._library().get(name, [])
        fitting = [one for one in candidates if version == (0,) or _fits(one.version, relation, version)]
        if not fitting:
            there = ", ".join(".".join(map(str, one.version)) for one in candidates)
            hint = f"there is version {there}" if there else "name its folder (core_roots:, or --cores)"
            self.found.missing.append(f"{core.path}: no core {wanted}: {hint}")
            return
        self.add(max(fitting, key=lambda one: one.version), "default")

    def _library(self) -> dict[str, list[_Core]]:
        if self._known is None:
            self._known = {}
            for path in dict.fromkeys(p.resolve() for root in self._roots for p in sorted(root.rglob("*.core"))):
                try:
                    core = _read(path)
                except BuildError:
                    continue  # of another kind, or for another tool
                self._known.setdefault(core.name, []).append(core)
        return self._known

    def _files(self, core: _Core, fileset: Mapping[str, Any], flags: frozenset[str], top: bool) -> None:
        for entry in _both(fileset, "files"):
            text, own = next(iter(entry.items())) if isinstance(entry, dict) else (entry, {})
            settings = {**fileset, **(own or {})}
            for name in names(text, flags):
                self._file(core, core.path.parent / name, settings, top)

    def _file(self, core: _Core, path: Path, settings: Mapping[str, Any], top: bool) -> None:
        kind = str(settings.get("file_type", ""))
        found = self.found
        if not kind.startswith(_HDL) and kind not in ("xdc", "tclSource", "xci"):
            return  # for another tool, or documentation
        if not path.exists():
            fetched = " (its provider would fetch it: fusesoc fetch)" if core.data.get("provider") else ""
            found.missing.append(f"{core.path}: {path.relative_to(core.path.parent)} does not exist{fetched}")
        elif settings.get("is_include_file"):
            folder = core.path.parent / settings["include_path"] if "include_path" in settings else path.parent
            found.include_dirs += [folder] if folder not in found.include_dirs else []
        elif kind.startswith(_HDL):
            library = settings.get("logical_name")
            named = library and kind.startswith("vhdl")
            (found.libraries.setdefault(str(library), []) if named else found.sources).append(path)
            found.own += [path] if top else []
        else:
            {"xdc": found.constraints, "tclSource": found.tcl, "xci": found.ip}[kind].append(path)

    def _parameters(self, core: _Core, target: Mapping[str, Any], flags: frozenset[str]) -> None:
        declared = core.data.get("parameters") or {}
        for entry in _both(target, "parameters"):
            for text in names(entry, flags):
                name, equals, value = text.partition("=")
                spec = declared.get(name) or {}
                given = _value(name, value, spec) if equals else spec.get("default")
                if given is None:
                    continue
                if spec.get("paramtype") == "vlogdefine":
                    self.found.defines[name] = "1" if given is True else str(given)
                elif spec.get("paramtype") in ("vlogparam", "generic"):
                    self.found.parameters[name] = given


def _value(name: str, text: str, spec: Mapping[str, Any]) -> Any:
    """Convert the value of `name=text` in a target. Raises ValueError if it does not fit the parameter."""
    if spec.get("datatype") in ("str", "file"):
        return text
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError:
        raise ValueError(f"the parameter {name} is given {text!r}, which is not a value") from None


def _both(data: Mapping[str, Any], key: str) -> Iterator[Any]:
    yield from data.get(key) or ()
    yield from data.get(f"{key}_append") or ()


def _fits(have: tuple[int, ...], relation: str, want: tuple[int, ...]) -> bool:
    size = max(len(have), len(want))
    left, right = (value + (0,) * (size - len(value)) for value in (have, want))
    if relation in ("^", "~"):
        same = 1 if relation == "^" else 2
        return left >= right and left[:same] == right[:same]
    return {"=": left == right, ">=": left >= right, ">": left > right, "<=": left <= right, "<": left < right}[
        relation
    ]


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
