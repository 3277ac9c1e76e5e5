# SPDX-License-Identifier: Apache-2.0
"""Reads files that describe modules, by kind: HDL, FuseSoC core, IP-XACT component, IP instance, hardware handoff.

`cm build init` and `cm build interfaces` are given any of them, together.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.hdl.errors import ModuleNotFound
from cm.design.hdl.extract import Sources, read
from cm.design.hdl.flat_wrappers import needs_wrapper
from cm.design.hdl.flatten import flatten
from cm.design.hdl.hwh_modules import load_hwh
from cm.design.hdl.ipxact import load_component_xml, load_xci
from cm.design.hdl.model import ModuleInfo, Problem
from cm.design.project.fusesoc import core_files
from cm.frozen import dataclass, replace

CPP = (".cpp", ".cc", ".cxx", ".c")


@dataclass(frozen=True, slots=True)
class Given:
    """A module, and the files of HDL that it needs, or the core, component or IP instance that it was read from.

    `asked`: what was taken for streams, and only a person knows.
    """

    info: ModuleInfo
    files: tuple[Path, ...] = ()
    origin: Path | None = None
    asked: tuple[str, ...] = ()

    @property
    def flat(self) -> ModuleInfo:
        """The module with the ports of its flat wrapper, if it needs one, under its own name."""
        if not needs_wrapper(self.info) or not self.files:
            return self.info
        return replace(flatten(self.info, Sources(self.files))[0], name=self.info.name)


def read_inputs(
    wanted: Sources, every: bool = False, cores: Sequence[Path] = ()
) -> tuple[list[Given], Sequence[Problem]]:
    """Return the modules of all files, those of HDL first, and the problems of files without any.

    Of HDL, without a top, those that no other instantiates, or `every` one. `cores`: where to look for what a FuseSoC
    core depends on.
    """
    sources = [path for path in wanted.files if path.suffix.lower() not in (".core", ".xml", ".xci", ".hwh", *CPP)]
    found: list[Given] = []
    problems: Sequence[Problem] = ()
    try:
        if sources:
            found, problems = _of_hdl(replace(wanted, files=sources), every)
    except ModuleNotFound:
        if len(sources) == len(wanted.files):
            raise
    for path in wanted.files:
        suffix = path.suffix.lower()
        if suffix == ".core":
            found += _of_core(path, wanted.top, cores)
        elif suffix == ".xml":
            found.append(Given(load_component_xml(path), origin=path))
        elif suffix == ".xci":
            found.append(Given(load_xci(path, wanted.protocols), origin=path))
        elif suffix == ".hwh":
            found += [Given(info, origin=path) for info in load_hwh(path, wanted.top)]
        elif suffix in CPP:
            what = "C++ says nothing of ports and registers before it is synthesised"
            raise BuildError(f"{path}: {what}: run Vitis HLS, and give the component.xml or the Verilog that it wrote")
    return found, problems


def _of_hdl(wanted: Sources, every: bool) -> tuple[list[Given], Sequence[Problem]]:
    reading = read(wanted, roots=not every)
    return [Given(info, reading.files[info.name]) for info in reading.modules], reading.problems


def _of_core(path: Path, top: str | None, cores: Sequence[Path]) -> list[Given]:
    listed = core_files(path, roots=cores)
    if listed.missing:
        raise BuildError("; ".join(listed.missing))
    parameters = {name: str(value) for name, value in listed.parameters.items()}
    held = Sources(listed.sources, None, listed.include_dirs, listed.defines, parameters, libraries=listed.libraries)
    if not held.paths:
        raise BuildError(f"{path}: target default has no Verilog or VHDL")
    own = {str(file) for file in listed.own}
    found = read(replace(held, top=top or listed.top), roots=True).modules
    return [Given(info, origin=path) for info in found if held.top or info.file in own]
