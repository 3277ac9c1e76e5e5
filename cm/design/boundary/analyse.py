# SPDX-License-Identifier: Apache-2.0
"""HDL of a project → interfaces per module and a boundary per region."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from cm.design.boundary.make import boundary
from cm.design.boundary.model import Boundary
from cm.design.errors import BuildError, MissingTool
from cm.design.hdl.associate import restated
from cm.design.hdl.compare_ipxact import compare
from cm.design.hdl.errors import HdlError, ModuleNotFound, WrongParameter
from cm.design.hdl.extract import Sources, read
from cm.design.hdl.flat_wrappers import Flat, needs_wrapper
from cm.design.hdl.flatten import flatten
from cm.design.hdl.hls_registers import HDL, differences
from cm.design.hdl.ipxact import load_component_xml, load_xci
from cm.design.hdl.model import Language, ModuleInfo, Polarity, Problem, Stated
from cm.design.hdl.register_maps import read_register_map
from cm.design.hdl.user_protocols import UserProtocol, load_protocols
from cm.design.hdl.vhdl_text import missing_units
from cm.design.project.model import ModuleSpec, Project, in_libraries
from cm.design.project.source_position import fault
from cm.frozen import dataclass, field, replace
from cm.schema.problems import did_you_mean

_SUBJECT = re.compile(r"(?:port )?(\w+)(?:\.(\w+))?")
_PRIMITIVE = re.compile(r"[A-Z][A-Z0-9_]*|xpm_\w+")  # in the vendor's library: BUFG, RAMB36E2, xpm_cdc_single


@dataclass(frozen=True, slots=True)
class Analysis:
    """What was found in the HDL: `modules` by their names in the project, `boundaries` by region.

    `differences` are those between extraction and IP-XACT, one sentence each, by module.
    """

    modules: Mapping[str, ModuleInfo]
    boundaries: Mapping[str, Boundary]
    differences: Mapping[str, tuple[str, ...]]
    flat: Mapping[str, Flat] = field(default_factory=dict)  # wrappers of modules whose ports are not vectors

    @property
    def refused(self) -> tuple[str, ...]:
        """Why modules do not fit their regions, one sentence each."""
        return tuple(
            f"{self.placed(adaptation.module, sentence)} (module {adaptation.module}, region {region})"
            for region, found in self.boundaries.items()
            for adaptation in found.adaptations
            for sentence in adaptation.refused
        )

    @property
    def broken(self) -> int:
        """The number of problems that make synthesis fail."""
        return sum(problem.breaks for info in self.modules.values() for problem in info.problems)

    def placed(self, module: str, sentence: str) -> str:
        """Put file and line before a sentence about a module: those of the port or interface that it begins with."""
        info = self.modules[module]
        if sentence.startswith(info.file):
            return sentence
        found = _SUBJECT.match(sentence)
        name, logical = (found[1], found[2]) if found else ("", None)
        interface = next((i for i in info.interfaces if i.name == name), None)
        if interface is not None:
            name = interface.ports.get(logical or "") or next(iter(interface.ports.values()))
        port = next((port for port in info.ports if port.name == name), None)
        line = port.line if port is not None and port.line else info.line
        file = port.file if port is not None and port.file else info.file
        return f"{file}:{line}: {sentence}" if line else f"{file}: {sentence}"

    def completed(self, project: Project) -> Project:
        """`project` with the registers of its modules' register maps; the build schema takes precedence."""
        modules = {name: _with_registers(project, self._named(spec)) for name, spec in project.modules.items()}
        return replace(project, modules=modules)

    def _named(self, spec: ModuleSpec) -> ModuleSpec:
        """Return the module with the top that synthesis sees: that of its vendor IP or its wrapper."""
        if spec.name in self.flat:
            flat = self.flat[spec.name]
            return replace(spec, top=flat.name, parameters={}, flat=(flat.file, flat.text))
        stated = spec.readable or spec.component is not None  # else it was read from its vendor IP
        return spec if stated else replace(spec, top=self.modules[spec.name].name)


def _with_registers(project: Project, spec: ModuleSpec) -> ModuleSpec:
    for bus, path in spec.register_maps.items():
        try:
            spec = _with_map(spec, bus or spec.interface or "", path)
        except MissingTool:
            raise
        except BuildError as error:
            key = ("modules", spec.name, "register_map", *([bus] if bus else ()))
            raise fault(project.source, key, str(error)) from None
    return spec


def _with_map(spec: ModuleSpec, bus: str, path: Path) -> ModuleSpec:
    """The module with what a register map says of one of its buses; what it has already, stays."""
    registers, memories, notes = read_register_map(path, spec.top, bus)
    # HLS has a file for each bus of a module: where one of them is named, the others are of other buses
    for other in () if HDL.match(path.name) else (source for source in spec.sources if HDL.match(source.name)):
        if wrong := differences(registers, read_register_map(other, "").registers):
            raise BuildError(f"{path.name} and {other} disagree: {'; '.join(wrong)}")
    elsewhere = {} if bus == (spec.interface or "") else dict.fromkeys((*registers, *memories), bus)
    twice = sorted({*elsewhere} & {*spec.registers, *spec.memories})
    if twice:
        first = spec.interface_of.get(twice[0], spec.interface or "")
        raise BuildError(f"{path}: {', '.join(twice)} are names on {first} too, and a register has one of its own")
    return replace(
        spec,
        registers={**registers, **spec.registers},
        memories={**memories, **spec.memories},
        interface_of={**spec.interface_of, **elsewhere},
        register_notes=(*spec.register_notes, *(f"{path.name}: {note}" for note in notes)),
    )


def analyse(project: Project) -> Analysis:
    """Parse all modules of `project`; raises the HDL half's errors for files that cannot be read."""
    protocols = tuple(protocol for path in project.protocols for protocol in load_protocols(path))
    modules: dict[str, ModuleInfo] = {}
    differences: dict[str, tuple[str, ...]] = {}
    flat: dict[str, Flat] = {}
    for spec in project.modules.values():
        try:
            modules[spec.name], differences[spec.name] = _module(spec, _sources(spec, protocols))
        except HdlError as error:
            raise fault(project.source, ("modules", spec.name, *_key(spec, error)), str(error)) from None
        found = modules[spec.name]
        if spec.readable and (needs_wrapper(found) or _elsewhere(spec, found)):
            wrapped, wrapper = flatten(found, _sources(spec, protocols))
            flat |= {spec.name: wrapper} if wrapper else {}
            modules[spec.name] = wrapped if wrapper or needs_wrapper(found) else found
        _check_stated(project, spec, modules[spec.name])
    # by the project's names, since two modules may have the same top with different parameters or sources
    boundaries = {
        name: boundary({spec.name: modules[spec.name] for spec in project.modules_of(name)}, region.interfaces)
        for name, region in project.regions.items()
    }
    return Analysis(modules, boundaries, differences, flat)


def _check_stated(project: Project, spec: ModuleSpec, info: ModuleInfo) -> None:
    """Raise a fault for a clock, reset or interface under ``clocks:`` or ``resets:`` that the module does not have."""
    ports = [port.name for port in info.ports]
    buses = [interface.name for interface in info.interfaces]
    named = [(("clocks", port), port, "port", ports) for port in spec.clocks]
    named += [(("clocks", port), bus, "interface", buses) for port, given in spec.clocks.items() for bus in given]
    named += [(("resets", port), port, "port", ports) for port in spec.resets]
    named += [(("interrupts", port), port, "port", ports) for port in spec.interrupts or ()]
    clocks = [clock.port for clock in info.clocks]
    named += [(("resets", port), clock, "clock", clocks) for port, (clock, _) in spec.resets.items() if clock]
    for key, name, kind, known in named:
        if name not in known:
            message = f"{info.name} has no {kind} {name}"
            raise fault(project.source, ("modules", spec.name, *key), message, did_you_mean(name, known))


def _elsewhere(spec: ModuleSpec, info: ModuleInfo) -> bool:
    """Whether the top is VHDL in a library other than the default, where the Verilog around it would not find it."""
    return info.language is Language.VHDL and Path(info.file) in in_libraries(spec.libraries)


def _sources(spec: ModuleSpec, protocols: tuple[UserProtocol, ...]) -> Sources:
    levels = {None: None, "low": Polarity.LOW, "high": Polarity.HIGH}
    resets = {port: (clock, levels[level]) for port, (clock, level) in spec.resets.items()}
    simulated = spec.ip and spec.sim_sources
    return Sources(
        files=spec.sim_sources if simulated else spec.sources,
        top=spec.top,
        include_dirs=spec.include_dirs,
        defines=spec.defines,
        parameters=_texts(spec.parameters),
        protocols=protocols,
        libraries={} if simulated else spec.libraries,
        interface_parameters={port: _texts(values) for port, values in spec.interface_parameters.items()},
        stated=Stated(spec.clocks, resets, spec.streams, spec.interrupts),
    )


def _texts(values: Mapping[str, object]) -> dict[str, str]:
    return {name: str(value) for name, value in values.items()}


def _key(spec: ModuleSpec, error: HdlError) -> tuple[str, ...]:
    """The key of a module in the build schema that has the problem."""
    if isinstance(error, WrongParameter):
        return ("parameters", error.name)
    if spec.component is not None and str(error).startswith(f"{spec.component}:"):
        return ("component",)
    return ("top",) if isinstance(error, ModuleNotFound) else ("sources",)


def _module(spec: ModuleSpec, sources: Sources) -> tuple[ModuleInfo, tuple[str, ...]]:
    if not spec.readable:
        if spec.component is None and not spec.ip:
            raise HdlError(f"{spec.name}: nothing describes its interfaces; give sources, sim_sources or component")
        stated = load_component_xml(spec.component) if spec.component else load_xci(spec.ip[0], sources.protocols)
        return restated(stated, sources.stated), ()
    described = load_component_xml(spec.component) if spec.component else None
    reading = read(sources)
    differ = compare(reading.modules[0], described) if described else []
    if differ:  # what the component says of its ports goes before names
        reading = read(replace(sources, described=described))
    found = reading.modules[0]
    units = () if spec.ip or spec.sim_sources else tuple(missing_units(spec.libraries, spec.sources))
    info = _with_missing(replace(found, problems=(*found.problems, *reading.problems, *units)), spec, reading.outside)
    return info, tuple(map(str, differ))


def _with_missing(info: ModuleInfo, spec: ModuleSpec, outside: Sequence[str]) -> ModuleInfo:
    """Add a problem for submodules that synthesis will not find; vendor IP may bring some, primitives always exist."""
    missing = [name for name in outside if not _PRIMITIVE.fullmatch(name)]
    if not missing or spec.ip or spec.tcl or spec.sim_sources:
        return info
    text = f"no file has {', '.join(missing)}, which {info.name} needs below it: add to sources: (or ip:, if vendor IP)"
    return replace(info, problems=(*info.problems, Problem(text, info.file, info.line, breaks=True)))
