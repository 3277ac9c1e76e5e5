# SPDX-License-Identifier: Apache-2.0
"""Modules whose ports are interfaces or records, as their flat wrappers present them."""

from __future__ import annotations

from pathlib import Path

from cm.design.hdl.errors import HdlError
from cm.design.hdl.extract import Sources, read
from cm.design.hdl.flat_verilog import flat_verilog
from cm.design.hdl.flat_vhdl import flat_vhdl
from cm.design.hdl.flat_wrappers import Flat
from cm.design.hdl.model import Language, ModuleInfo, Problem
from cm.frozen import replace


def flatten(info: ModuleInfo, wanted: Sources) -> tuple[ModuleInfo, Flat | None]:
    """Return the wrapper of `info`, read from `wanted`, as a module and as text.

    If it cannot be wrapped, the module itself is returned, with the reason.
    """
    try:
        wrap = flat_vhdl if info.language is Language.VHDL else flat_verilog
        flat = wrap(info.name, wanted)
    except HdlError as why:
        return replace(info, problems=(*info.problems, Problem(str(why), info.file, info.line, fatal=True))), None
    found = read(replace(wanted, top=flat.name, parameters={}), {Path(flat.file): flat.text}).modules[0]
    said = {problem.message: replace(problem, file=info.file, line=info.line) for problem in found.problems}
    said |= {problem.message: problem for problem in info.problems if not problem.fatal}
    below = tuple(dict.fromkeys([*found.instantiates, *info.instantiates]))
    return replace(found, file=info.file, line=info.line, problems=tuple(said.values()), instantiates=below), flat
