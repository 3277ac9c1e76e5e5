# SPDX-License-Identifier: Apache-2.0
"""Reads a build schema: YAML → `cm.design.project.model.Project`, every problem with its position.

File names in a build schema: relative to its folder; `*` matches files, in sorted order.

Small parts of a build schema: connections, registers, streams of modes, values of macros.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cm.design.boards import BoardDefinition, boards
from cm.design.compile_order import compile_order
from cm.design.errors import BuildError
from cm.design.project import references
from cm.design.project.fusesoc import with_core
from cm.design.project.model import (
    BitstreamSpec,
    ConnectionSpec,
    ModeSpec,
    ModeStreamSpec,
    ModuleSpec,
    Project,
    RegionSpec,
    Resources,
    StaticSpec,
    SwitchSpec,
)
from cm.frozen import replace
from cm.schema.construct import Context, bit_fields
from cm.schema.loader import Loading, decoded
from cm.schema.model import Access, Clock, LoaderKind, Memory, Register
from cm.schema.pictures import pixel_shape
from cm.schema.problems import KeyPath, Problem, SchemaError
from cm.schema.structure import Structure
from cm.schema.tree import Mark, locate

Report = Callable[[KeyPath, str, str, str], None]


def connection(spec: dict[str, Any]) -> ConnectionSpec:
    """An interface of a region."""
    spec = dict(spec)
    shape, single = spec.pop("shape", None), spec.pop("pin", None)
    pins = {name.lower(): tuple(given) for name, given in (spec.pop("pins", None) or {}).items()}
    if single:
        pins[""] = tuple(single)
    given = pixel_shape(tuple(shape) if shape else None, spec.get("format"))
    return ConnectionSpec(**spec, shape=given, pins=pins)


def switch(spec: dict[str, Any], clock: str) -> SwitchSpec:
    """The switch between regions; `clock` is the default one."""
    ends = {
        side: {name: replace(connection(value or {}), stream=name) for name, value in (spec.get(side) or {}).items()}
        for side in ("inputs", "outputs")
    }
    return SwitchSpec(spec.get("clock", clock), **ends)


def mode_stream(spec: dict[str, Any]) -> ModeStreamSpec:
    """A stream in a mode."""
    shape = spec.get("shape")
    return ModeStreamSpec(tuple(shape) if shape else None, spec.get("dtype"))


def registers(spec: dict[str, Any], where: KeyPath, report: Report) -> dict[str, Register]:
    """Registers by name; `base_address` is 0, as long as no window is planned."""
    given, context = spec.get("registers") or {}, Context(report)
    return {name: _register(name, value, (*where, "registers", name), context) for name, value in given.items()}


def _register(name: str, spec: dict[str, Any], path: KeyPath, context: Context) -> Register:
    fields = bit_fields(spec.get("fields") or {}, (*path, "fields"), context)
    rest = {{"min": "minimum", "max": "maximum"}.get(key, key): value for key, value in spec.items()}
    return Register(name, 0, **{**rest, "access": Access(spec.get("access", "rw")), "fields": fields})


def memories(spec: dict[str, Any]) -> dict[str, Memory]:
    """Memories by name, as `registers`."""
    return {name: _memory(name, values) for name, values in (spec.get("memories") or {}).items()}


def _memory(name: str, spec: dict[str, Any]) -> Memory:
    shape = tuple(spec["shape"]) if "shape" in spec else None
    return Memory(name, 0, **{**spec, "access": Access(spec.get("access", "rw")), "shape": shape})


def macro(value: object) -> str:
    """Write a macro's value as the preprocessor expects it."""
    if value is None or value is True:
        return "1"
    return "0" if value is False else str(value)


class PathReader:
    """Turns names into absolute paths, and reports those that do not exist."""

    def __init__(self, folder: Path, report: Report) -> None:
        self._folder, self._report = folder, report

    def many(self, names: Sequence[str] | None, key: KeyPath) -> tuple[Path, ...]:
        """The files of a list of names, in order."""
        found: list[Path] = []
        for index, name in enumerate(names or ()):
            found += self._expand(name, (*key, index))
        return tuple(found)

    def one(self, name: str | None, key: KeyPath) -> Path | None:
        """One file, or None if no name is given."""
        return next(iter(self._expand(name, key)), None) if name else None

    def _expand(self, name: str, key: KeyPath) -> list[Path]:
        pattern = Path(name)
        if "*" in name:
            base, relative = (Path("/"), str(pattern)[1:]) if pattern.is_absolute() else (self._folder, name)
            files = sorted(path for path in base.glob(relative) if path.is_file())
            if not files:
                self._report(key, "file_not_found", f"no file fits {name}", f"looked in {self._folder}")
            return [normal(path) for path in files]
        path = pattern if pattern.is_absolute() else self._folder / pattern
        if not path.exists():
            self._report(key, "file_not_found", f"{name} does not exist", f"looked in {self._folder}")
        return [normal(path)]


def normal(path: Path) -> Path:
    """Return an absolute path without ``.`` and ``..``, unless a link makes that another file."""
    whole = Path(os.path.normpath(path.absolute()))
    return whole if not path.exists() or (whole.exists() and whole.samefile(path)) else path.absolute()


SCHEMA_FILE = Path(__file__).parents[1] / "data" / "build.schema.json"
DEFAULT_CLOCK = "fclk0"
DEFAULT_RATE = 100_000_000


class DesignFile(Loading):
    """A build schema, or a file beside it; `schema`: its JSON Schema, `begin`: what an empty one should begin with."""

    def __init__(self, text: str, source: Path, schema: Path, begin: str) -> None:
        super().__init__(text, source, Structure(json.loads(schema.read_text(encoding="utf-8"))))
        self._begin = begin

    def report(self, path: KeyPath, code: str, message: str, hint: str = "") -> None:
        """At the key of the file, as what is found later is (`source_position.fault`)."""
        self.report_at(locate(self.given, path), path, code, message, hint)

    def report_at(self, mark: Mark, path: KeyPath, code: str, message: str, hint: str) -> None:
        """With hints for this kind of schema."""
        if code == "unknown_key" and path[-1:] == ("hls",):
            hint = "run Vitis HLS, and give component: or sources: with what it wrote"
        super().report_at(mark, path, code, message, hint.replace("config:", self._begin))


def load_project(path: Path | str, text: str | None = None) -> Project:
    """Load the build schema in `path`, or `text` as if it were there; of a folder its ``build.yaml``.

    Raises SchemaError with every problem.
    """
    path = _file(path)
    loading = _loading(path, text)
    project = _Builder(path, loading.usable(), loading).project()
    references.check(project, loading.report)
    loading.stop_if_wrong()
    return project


def project_data(path: Path | str) -> dict[str, Any]:
    """Load the build schema in `path` as plain data in normal form. Raises SchemaError as `load_project` does."""
    return _loading(_file(path), None).values()


def _file(path: Path | str) -> Path:
    path = normal(Path(path))
    return path / "build.yaml" if path.is_dir() else path


def _loading(path: Path, text: str | None) -> DesignFile:
    try:
        text = decoded(path.read_bytes(), path) if text is None else text
    except OSError as error:
        message = f"cannot be read: {error.strerror or error}"
        hint = "cm build init FILE… writes a first one from HDL" if isinstance(error, FileNotFoundError) else ""
        raise SchemaError([Problem(path, 1, 1, "", "unreadable", message, hint)]) from None
    return DesignFile(text, path, SCHEMA_FILE, "project: (or with cm build init)")


class _Builder:
    def __init__(self, path: Path, data: dict[str, Any], loading: Loading) -> None:
        self._path, self._data, self._stop = path, data, loading.stop_if_wrong
        self._report = loading.report
        self._files = PathReader(path.parent, loading.report)
        self._kit: BoardDefinition | None = None

    def project(self) -> Project:
        data = self._data
        head = data["project"]
        self._kit = self._board(head)
        clocks = self._clocks()
        regions = {name: self._region(name, spec, next(iter(clocks))) for name, spec in data["regions"].items()}
        modules = {name: self._module(name, spec, tuple(regions)) for name, spec in data["modules"].items()}
        modes = self._modes(modules)
        return Project(
            name=head["name"],
            part=head.get("part") or (self._kit.part if self._kit else ""),
            source=self._path,
            board=self._kit.board_part if self._kit else head.get("board"),
            kit=self._kit,
            vivado=head.get("vivado"),
            doc=head.get("doc", ""),
            clocks=clocks,
            static=self._static(),
            bitstream=BitstreamSpec(**data.get("bitstream") or {}),
            regions=regions,
            modules=modules,
            modes=modes,
            modes_given=bool(data.get("modes")),
            default_mode=data.get("default_mode", next(iter(modes), "")),
            protocols=self._files.many(data.get("protocols"), ("protocols",)),
            switch=switch(data["switch"] or {}, next(iter(clocks))) if "switch" in data else None,
        )

    def _board(self, head: dict[str, Any]) -> BoardDefinition | None:
        """Find the board in the library; a Vivado board part is used as it is."""
        name, part = head.get("board", ""), head.get("part")
        kit = boards().get(name)
        if kit is None and name and ":" not in name:
            references.unknown(self._report, ("project", "board"), "board", name, boards())
        elif kit is None and not part:
            self._report(("project",), "missing_key", "part is missing", "or name a board of the library")
        elif kit is not None and part and part.lower() != kit.part.lower():
            message = f"{kit.title} has {kit.part}, not {part}"
            self._report(("project", "part"), "bad_value", message, "leave part out")
        return kit

    def _clocks(self) -> dict[str, Clock]:
        own = {name: {"rate": rate} for name, rate in self._kit.clocks.items()} if self._kit else None
        given = self._data.get("clocks") or own or {DEFAULT_CLOCK: {"rate": DEFAULT_RATE}}
        return {
            name: Clock(name, **{**spec, "tolerance": float(spec.get("tolerance", 1.0))})
            for name, spec in given.items()
        }

    def _static(self) -> StaticSpec:
        spec = _said(self._data.get("static"))
        files = {
            key: self._files.many(spec.get(key), ("static", key))
            for key in ("sources", "include_dirs", "block_design", "constraints")
        }
        files["sources"] = compile_order(files["sources"])
        own = {"libraries": self._libraries(spec, ("static",)), "registers": registers(spec, ("static",), self._report)}
        return StaticSpec(**{**spec, **files, **own, "revision": str(spec.get("revision", ""))})

    def _libraries(self, spec: dict[str, Any], where: KeyPath) -> dict[str, tuple[Path, ...]]:
        given = spec.get("libraries") or {}
        return {
            name: compile_order(self._files.many(paths, (*where, "libraries", name))) for name, paths in given.items()
        }

    def _region(self, name: str, given: dict[str, Any] | None, clock: str) -> RegionSpec:
        spec = _said(given)
        pblock = tuple(self._ranges(name, spec.get("pblock", ())))
        own = {
            "pblock": () if pblock == ("auto",) else pblock,
            "resources": Resources(**spec.get("resources", {})),
            "loader": LoaderKind(spec.get("loader", "auto")),
            "interfaces": {key: connection(value or {}) for key, value in spec.get("interfaces", {}).items()},
        }
        return RegionSpec(name, **{"clock": clock, **spec, **own})

    def _ranges(self, region: str, given: Iterable[str]) -> Iterator[str]:
        """Yield ranges; names of the board library are replaced by their ranges."""
        known = self._kit.pblocks if self._kit else {}
        for index, text in enumerate(given):
            word, _, name = text.partition(":")
            if word != "proven":
                yield text
            elif name in known:
                yield from known[name]
            else:
                key = ("regions", region, "pblock", index)
                references.unknown(self._report, key, "pblock of the board", name, known)

    def _module(self, name: str, given: dict[str, Any] | None, regions: tuple[str, ...]) -> ModuleSpec:
        where, spec = ("modules", name), _said(given)
        own: dict[str, Any] = {
            key: self._files.many(spec.get(key), (*where, key))
            for key in ("sources", "include_dirs", "ip", "ip_repositories", "tcl", "constraints", "sim_sources")
        }
        own |= {
            "component": self._files.one(spec.get("component"), (*where, "component")),
            "register_maps": self._register_maps(spec.get("register_map", {}), (*where, "register_map")),
            "libraries": self._libraries(spec, where),
            "regions": tuple(spec.get("regions", regions if len(regions) == 1 else ())),
            "defines": {key: macro(value) for key, value in spec.get("defines", {}).items()},
            "registers": registers(spec, where, self._report),
            "memories": memories(spec),
            "clocks": {key: tuple((one or {}).get("interfaces", ())) for key, one in spec.get("clocks", {}).items()},
            "resets": {key: (one.get("clock"), one.get("polarity")) for key, one in spec.get("resets", {}).items()},
            **{key: tuple(spec[key]) if key in spec else None for key in ("streams", "interrupts")},
            "resources": Resources(**spec.get("resources", {})),
        }
        plain = {key: value for key, value in spec.items() if not key.startswith("core") and key != "register_map"}
        first = next(iter(own["register_maps"]), "") or None  # whose registers: of the build schema are, unless it says
        module = ModuleSpec(name, **{"top": name, "interface": first, **plain, **own})
        core = self._files.one(spec.get("core"), (*where, "core"))
        if core is None or not core.is_file():
            return _ordered(module)
        roots = self._files.many(spec.get("core_roots"), (*where, "core_roots"))
        try:
            return _ordered(with_core(module, core, spec.get("core_target", "default"), roots, "top" in spec))
        except BuildError as error:
            self._report((*where, "core"), "bad_core", str(error), "")
            self._stop()
            raise

    def _register_maps(self, given: Mapping[str, str], where: KeyPath) -> dict[str, Path]:
        found = {bus: self._files.one(name, (*where, bus) if bus else where) for bus, name in given.items()}
        return {bus: path for bus, path in found.items() if path is not None}

    def _modes(self, modules: dict[str, ModuleSpec]) -> dict[str, ModeSpec]:
        given = self._data.get("modes")
        if not given:
            return _implied_modes(modules)
        return {name: self._mode(name, spec, modules) for name, spec in given.items()}

    def _mode(self, name: str, spec: dict[str, Any], modules: dict[str, ModuleSpec]) -> ModeSpec:
        chosen: dict[str, str] = {}
        for key, value in spec["modules"].items():
            region, module = (key, value) if value is not None else (self._only_region(name, key, modules), key)
            if region in chosen:
                message = f"{chosen[region]} and {module} both go to {region}"
                self._report(("modes", name, "modules"), "region_conflict", message, "a region holds one module")
            if region is not None:
                chosen[region] = module
        streams = {key: mode_stream(value) for key, value in (spec.get("streams") or {}).items()}
        share, doc, routes = spec.get("share", 1.0), spec.get("doc", ""), spec.get("routes") or {}
        return ModeSpec(name, chosen, spec.get("registers") or {}, streams, share, doc, spec.get("run"), routes)

    def _only_region(self, mode: str, module: str, modules: dict[str, ModuleSpec]) -> str | None:
        if module not in modules:
            references.unknown(self._report, ("modes", mode, "modules", module), "module", module, modules)
            return None
        regions = modules[module].regions
        if len(regions) != 1:
            message = f"{module} may go to {', '.join(regions) or 'no region'}"
            self._report(("modes", mode, "modules"), "ambiguous", message, f"write region: {module}")
            return None
        return regions[0]


def _said(spec: dict[str, Any] | None) -> dict[str, Any]:
    """The keys that have a value: a key with none, or a part that is empty, says nothing."""
    return {key: value for key, value in (spec or {}).items() if value is not None}


def _ordered(module: ModuleSpec) -> ModuleSpec:
    """Return a module with its files in the order in which tools need them."""
    return replace(module, sources=compile_order(module.sources), sim_sources=compile_order(module.sim_sources))


def _implied_modes(modules: dict[str, ModuleSpec]) -> dict[str, ModeSpec]:
    """Make modes if the file has none: one for each module, or one for each region it may go to."""
    modes = {}
    for module in modules.values():
        for region in module.regions:
            name = module.name if len(module.regions) == 1 else f"{module.name}_{region}"
            modes[name] = ModeSpec(name, {region: module.name})
    return modes
