# SPDX-License-Identifier: Apache-2.0
"""Modules whose ports are interfaces or records, as their flat wrappers present them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cm.design.hdl.errors import HdlError
from cm.design.hdl.extract import Reading, read
from cm.design.hdl.flat import Flat, Wanted
from cm.design.hdl.flat_verilog import flat_verilog
from cm.design.hdl.flat_vhdl import flat_vhdl
from cm.design.hdl.model import Language, ModuleInfo, Problem
from cm.design.hdl.protocols import UserProtocol


def flatten(info: ModuleInfo, wanted: Wanted, protocols: Sequence[UserProtocol] = ()) -> tuple[ModuleInfo, Flat | None]:
    """Return the wrapper, as a module and as text; or the module itself, with the reason, if it cannot be wrapped."""
    try:
        flat = flat_vhdl(wanted) if info.language is Language.VHDL else flat_verilog(wanted)
    except HdlError as why:
        return replace(info, problems=(*info.problems, Problem(str(why), info.file, info.line, fatal=True))), None
    found = _read(wanted, flat, protocols).modules[0]
    problems = tuple(problem for problem in info.problems if not problem.fatal)
    below = tuple(dict.fromkeys([*found.instantiates, *info.instantiates]))
    return replace(found, file=info.file, line=info.line, problems=problems, instantiates=below), flat


def _read(wanted: Wanted, flat: Flat, protocols: Sequence[UserProtocol]) -> Reading:
    files = [*(path for paths in wanted.libraries.values() for path in paths), *wanted.sources]
    generated = {Path(flat.file): flat.text}
    return read(files, flat.name, wanted.include_dirs, wanted.defines, {}, protocols, generated, wanted.stated)
