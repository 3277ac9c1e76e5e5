# SPDX-License-Identifier: Apache-2.0
"""`cm build init`: a first, commented build schema from HDL files."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cm.design.boundary.make import boundary
from cm.design.boundary.model import Boundary, Role
from cm.design.check.rules import check_system
from cm.design.compile_order import compile_order
from cm.design.errors import BuildError
from cm.design.generate.generation import load_design
from cm.design.hdl.clock_reset_names import REGION_CLOCK
from cm.design.hdl.extract import Sources
from cm.design.hdl.hls_registers import HDL, hls_interface
from cm.design.hdl.ipxact import component_files
from cm.design.hdl.model import Mode, ModuleInfo, Stated
from cm.design.hdl.register_maps import read_register_map
from cm.design.input_kinds import Given, read_inputs
from cm.design.platforms import platform_of
from cm.design.project.load import DEFAULT_CLOCK, DEFAULT_RATE
from cm.design.render import Renderer
from cm.design.runtime.answers import Answers
from cm.design.runtime.schema import runtime_config
from cm.errors import CmError
from cm.formats.registers import identifier
from cm.frozen import dataclass, replace

DEFAULT_PART = "xc7z020clg400-1"
# part → a board that has it, as named in its board file in Xilinx/XilinxBoardStore 20bbb12
_BOARDS = {
    "xc7z010clg400-1": "digilentinc.com:zybo-z7-10:part0:1.0",
    "xc7z020clg400-1": "tul.com.tw:pynq-z2:part0:1.0",
    "xc7z020clg484-1": "avnet.com:zedboard:part0:1.4",
    "xczu3eg-sbva484-1-i": "avnet.com:ultra96v2:part0:1.2",
    "xczu5eg-sfvc784-1-e": "tul.com.tw:pynqzu:part0:1.1",
    "xczu7ev-ffvc1156-2-e": "xilinx.com:zcu104:part0:1.1",
    "xczu9eg-ffvb1156-2-e": "xilinx.com:zcu102:part0:3.4",
    "xck26-sfvc784-2LV-c": "xilinx.com:kv260_som:part0:1.4",
}
_INTEGER = re.compile(r"-?\d+")


@dataclass(frozen=True, slots=True)
class Proposal:
    """A module for the region."""

    name: str
    info: ModuleInfo
    keys: Mapping[str, Any]  # keys of the build schema, beside those that comments explain

    @property
    def summary(self) -> str:
        """Its interfaces on one line."""
        found = [f"{i.name} ({i.protocol} {i.mode.value})" for i in self.info.interfaces]
        found += [f"{i.port} (interrupt)" for i in self.info.interrupts]
        return ", ".join(found)


def init_text(wanted: Sources, folder: Path, name: str, part: str = DEFAULT_PART, cores: Sequence[Path] = ()) -> str:
    """Return the text of a build schema in `folder` for the modules in the files of `wanted`.

    Files are HDL, FuseSoC cores (those that they depend on below `cores`), component.xml, .xci.
    Of HDL, modules that no other one instantiates and that have a bus interface become modules of one region;
    with a top, only that module does. Raises BuildError if there is none.
    """
    if built := next((path for path in wanted.files if path.suffix.lower() == ".hwh"), None):
        raise BuildError(
            f"{built} describes a design that is built: cm import takes it, and register_map: its registers"
        )
    platform = platform_of(part)
    given = [_with_streams(one, wanted) for one in read_inputs(wanted, cores=cores)[0]]
    read = [(one.flat, _keys(one, folder, cores, wanted.include_dirs) | _values(one, wanted)) for one in given]
    modules = [Proposal(identifier(info.name), info, keys) for info, keys in read if info.interfaces and info.usable]
    if not modules:
        names = "; ".join(_why_not(info) for info, _ in read) or f"no module {wanted.top}"
        raise BuildError(f"no module with a bus interface that could go into a region: found {names}")
    found = boundary({one.info.name: one.info for one in modules})  # whether they fit one region
    context = {
        "name": identifier(name),
        "part": part,
        "board": _BOARDS.get(part, "VENDOR:BOARD:part0:VERSION"),
        "clock": DEFAULT_CLOCK if platform.name == "zynq7000" else "pl_clk0",
        "rate": f"{DEFAULT_RATE:_}",
        "modules": modules,
        "left_out": [info for info, _ in read if not (info.interfaces and info.usable)],
        "streams": list(_streams(found)),
        "clocks": _further_clocks(found),
        "refused": [f"{a.module}: {sentence}" for a in found.adaptations for sentence in a.refused],
        "registers": {module.name: _register_bus(module.info) for module in modules},
    }
    return Renderer(folder, folder, "").render("build.yaml.j2", context)


def _with_streams(given: Given, wanted: Sources) -> Given:
    """The module with all that may be streams taken for such: its key ``streams`` names them, for a person to check."""
    if not given.info.asked or not given.files:
        return given
    taken = replace(wanted, files=given.files, top=given.info.name, stated=Stated(streams=given.info.asked))
    return replace(read_inputs(taken)[0][0], asked=given.info.asked)


def _keys(given: Given, folder: Path, cores: Sequence[Path], include_dirs: Sequence[Path]) -> dict[str, Any]:
    """The keys that a build schema in `folder` needs for a module."""

    def listed(paths: Iterable[Path]) -> list[str]:
        return [Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix() for path in paths]

    origin, maps = given.origin, dict[str, Path]()
    if origin is None:
        sources = compile_order(given.files)
        keys: dict[str, Any] = {"sources": listed(sources), "include_dirs": listed(include_dirs)}
        keys["streams"] = list(given.asked)
        maps = _register_maps(given, sources)
    elif origin.suffix.lower() == ".core":
        keys = {"top": given.info.name, "core": listed([origin]), "core_roots": listed(cores)}
    elif origin.suffix.lower() == ".xci":
        keys = {"ip": listed([origin])}
    else:
        files = component_files(origin)
        keys = {"top": given.info.name, "component": listed([origin])}
        keys |= {name: listed(getattr(files, name)) for name in ("sources", "include_dirs", "ip", "constraints", "tcl")}
        keys["libraries"] = {library: listed(paths) for library, paths in files.libraries.items()}
        maps = _register_maps(given, files.sources, origin)
    keys |= {name: keys[name][0] for name in ("core", "component") if keys.get(name)}
    found = {bus: listed([path])[0] for bus, path in maps.items()}
    keys["register_map"] = found.get("", found)
    return {name: value for name, value in keys.items() if value}


def _values(given: Given, wanted: Sources) -> dict[str, Any]:
    """The macros, and those of the parameters that the module has, as they were given for its HDL."""
    own = {parameter.name.lower() for parameter in given.info.parameters if not parameter.local}
    parameters = {n: int(v) if _INTEGER.fullmatch(v) else v for n, v in wanted.parameters.items() if n.lower() in own}
    keys = {"defines": dict(wanted.defines), "parameters": parameters}
    return {key: values for key, values in keys.items() if values and given.origin is None}


def _register_maps(given: Given, sources: Sequence[Path], *component: Path) -> dict[str, Path]:
    """The files that list the registers, by interface: of HLS's own ones the HDL's, then a component, if it has any.

    Of several of HLS, which are of an interface each, that with what starts the module is first. "": the only one.
    """
    own = [path for path in sources if HDL.match(path.name)]
    found = {path: names for path in (*own, *component) if (names := _described(path))}
    if len(own) < 2:
        return {"": next(iter(found))} if found else {}
    buses = {hls_interface(path, given.info.name): path for path in own if path in found}
    there = [interface.name for interface in given.info.interfaces if interface.name in buses]
    return {bus: buses[bus] for bus in sorted(there, key=lambda bus: "ap_ctrl" not in found[buses[bus]])}


def _described(path: Path) -> set[str]:
    """The registers and memories of a register map; none, if it has none or cannot be read."""
    with contextlib.suppress(BuildError):
        registers, memories, _ = read_register_map(path, "")
        return {*registers, *memories}
    return set()


def _why_not(info: ModuleInfo) -> str:
    """Name a module and what is wrong with it."""
    reasons = [str(problem) for problem in info.problems if problem.fatal]
    return f"{info.name} ({reasons[-1]})" if reasons else info.name


def _further_clocks(found: Boundary) -> list[str]:
    """The clock ports of the region that do not get its own clock by themselves."""
    ports = [port.name for port in found.ports if port.role is Role.CLOCK]
    return [name for name in ports if name != REGION_CLOCK] if len(ports) > 1 else []


def what_is_missing(path: Path) -> list[str]:
    """What keeps the build schema in `path` from being generated, one sentence each."""
    try:
        design = load_design(path)
        runtime_config(design.system, Answers())
    except CmError as error:
        return str(error).splitlines()
    findings = [finding.text(path) for finding in check_system(design.system) if finding.error]
    problems = [problem for info in design.analysis.modules.values() for problem in info.problems if problem.breaks]
    return [*findings, *map(str, problems)]


def _streams(found: Boundary) -> Iterable[Mapping[str, str]]:
    for interface in found.interfaces:
        if interface.protocol == "axis":
            direction = "from memory" if interface.mode is Mode.SLAVE else "to memory"
            yield {"name": interface.name, "direction": direction, "width": str(interface.data_width)}


def _register_bus(info: ModuleInfo) -> str:
    return next((i.name for i in info.interfaces if i.protocol == "axi4lite" and i.mode is Mode.SLAVE), "")
