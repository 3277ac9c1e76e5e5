# SPDX-License-Identifier: Apache-2.0
"""The files that the steps of the flow read: what their scripts name, and what decides whether a step runs again.

The static part's identity: a hash of everything that it is made from, the same on every machine.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from cm.design.plan.system import Implementation, System
from cm.design.project.model import in_libraries
from cm.design.render import by_language

RTL = Path(__file__).parents[1] / "rtl"
_KINDS = ("verilog", "systemverilog", "vhdl", "header")
_MEMORY = re.compile(r"""\$readmem[hb]\s*\(\s*"([^"\n]+)\"""")
_INIT_FILE = re.compile(r"""file_open\s*\([^;]*?"([^"\n]+)\"""", re.IGNORECASE)


def library(system: System) -> list[Path]:
    """The library's files for a static part: what it does not ask for would change the identity of others."""
    found = sorted(RTL.glob("*.v"))
    return [*found, RTL / "readback/cm_icap_read.v"] if system.readback else found


def static_files(system: System, out: Path) -> dict[str, Any]:
    """Sources of the static part by language, its constraints and include folders."""
    spec = system.project.static
    generated = [out / "hdl/cm_top.v", out / "hdl/cm_static.v"]
    generated += [out / f"hdl/{region.module}.v" for region in system.regions]
    generated += [out / f"hdl/lib/{path.name}" for path in library(system)]
    constraints = [out / "constraints/static.xdc", out / "constraints/pins.xdc", *spec.constraints]
    return by_language([*generated, *spec.sources]) | {
        "constraints": constraints,
        "include_dirs": list(spec.include_dirs),
        "libraries": spec.libraries,
    }


def module_files(one: Implementation, out: Path) -> dict[str, Any]:
    """Sources of a module in its wrapper, with its macros and include folders."""
    module = one.module
    own = [out / f"hdl/lib/{path.name}" for path in sorted(RTL.glob("cm_axi_slave_decoupler*.v"))]
    flat = [out / f"wrappers/{one.name}/{module.flat[0]}"] if module.flat else []
    sources = by_language([out / f"wrappers/{one.name}/{one.region.module}.v", *own, *module.sources, *flat])
    defines = [name if value == "1" else f"{name}={value}" for name, value in module.defines.items()]
    include_dirs = list(dict.fromkeys([*module.include_dirs, *(path.parent for path in sources["header"])]))
    context: dict[str, Any] = {"name": one.name, "module": module, "region": one.region}
    context["ip_repositories"] = module.ip_repositories
    return context | sources | {"defines": defines, "include_dirs": include_dirs, "libraries": module.libraries}


def of_step(system: System, step: str, out: Path) -> list[Path]:
    """The files whose content decides whether a step has to run again."""
    found = [out / f"tcl/step_{step}.tcl", out / "tcl/settings.tcl"]
    if step == "system":
        found += [out / "tcl/block_design.tcl", *system.project.static.block_design]
    elif step == "static":
        static = static_files(system, out)
        found += [path for kind in (*_KINDS, "constraints") for path in static[kind]]
        spec = system.project.static
        found += [*in_libraries(spec.libraries), *_headers(spec.include_dirs), *memories(spec.sources)]
    elif step.startswith("synth_"):
        found += _module(next(i for i in system.implementations if f"synth_{i.name}" == step), out)
    elif step == "run_1":
        found.append(out / "tcl/floorplan.tcl")
    return list(dict.fromkeys(found))


def _module(one: Implementation, out: Path) -> Iterator[Path]:
    module = one.module
    context = module_files(one, out)
    for kind in _KINDS:
        yield from context[kind]
    yield from in_libraries(module.libraries)
    yield from (*module.ip, *module.constraints, *module.tcl, *_headers(module.include_dirs))
    yield from memories(module.sources)


def _headers(folders: tuple[Path, ...]) -> list[Path]:
    suffixes = (".vh", ".svh", ".h", ".inc", ".v", ".sv")
    return [path for folder in folders for path in sorted(folder.iterdir()) if path.suffix in suffixes]


def memories(sources: Iterable[Path]) -> Iterator[Path]:
    """Files of initial values ($readmemh, $readmemb, VHDL's file_open) that lie beside their source."""
    for path in sources:
        if not path.is_file():
            continue
        text = path.read_text(encoding="utf-8", errors="replace")
        for name in (*_MEMORY.findall(text), *_INIT_FILE.findall(text)):
            found = path.parent / name
            if found.is_file():
                yield found


STEPS = ("system", "static", "run_1")  # steps whose inputs make the locked static part, beside run_1's


def static_paths(system: System, out: Path) -> list[Path]:
    """The files that the static part is made from: generated ones below `out`, and the user's."""
    return list(dict.fromkeys(path for step in STEPS for path in of_step(system, step, out)))


def static_identity(system: System, out: Path, texts: Mapping[str, str]) -> int:
    """32 bits of SHA-256 over names and contents, and ``static: revision``; never 0 or all ones.

    `texts` are the generated files (path below `out` → text) with an identity of 0; the others are read, and one that
    is missing counts as such, although `load_project` would have refused it.
    """
    digest = hashlib.sha256()
    _add(digest, "revision", system.project.static.revision.encode())
    for path in static_paths(system, out):
        name, data = _content(system, path, out, texts)
        _add(digest, name, data)
    return int.from_bytes(digest.digest()[:4], "big") % 0xFFFF_FFFE + 1


def _content(system: System, path: Path, out: Path, texts: Mapping[str, str]) -> tuple[str, bytes]:
    name = path.relative_to(out).as_posix() if path.is_relative_to(out) else ""
    if name in texts:
        return f"generated {name}", texts[name].encode()
    if name.startswith("hdl/lib/"):
        path = next(found for found in library(system) if found.name == path.name)
        return f"library {path.name}", path.read_bytes()
    name = Path(os.path.relpath(path, system.project.folder)).as_posix()
    return f"given {name}", path.read_bytes() if path.is_file() else b"missing"


def _add(digest: hashlib._Hash, name: str, data: bytes) -> None:
    """Add a file, with lengths before name and content, so that different lists of files never give the same bytes."""
    for part in (name.encode(), data):
        digest.update(len(part).to_bytes(8, "big") + part)
