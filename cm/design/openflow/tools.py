# SPDX-License-Identifier: Apache-2.0
"""The open tools: found on PATH, or in a folder that Debian's packages fill."""

from __future__ import annotations

import os
import shutil
import stat
from dataclasses import dataclass
from pathlib import Path

from cm.design.debian_packages import PackagesUnavailable, PackageTree, default_folder, fetch
from cm.design.errors import MissingTool
from cm.formats.xray import DatabaseMissing, find_database

YOSYS, NEXTPNR = "yosys", "nextpnr-himbaechel-xilinx"
PACKAGES = (NEXTPNR, f"{NEXTPNR}-chipdb", "prjxray", "prjxray-database", YOSYS)
_HINT = "cm build tools --fetch brings it from Debian's packages"
_ABC = """#!/bin/sh
here=$(dirname "$0")
usr=$here/../../usr
libraries=$(for folder in "$usr"/lib/*-linux-gnu "$usr"/lib; do printf '%s:' "$folder"; done)
exec "$here/ld.so" --library-path "$libraries" "$usr/bin/yosys-abc" "$@"
"""


@dataclass(frozen=True, slots=True)
class Tool:
    """A program: its command, and variables to add to the environment."""

    name: str
    command: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return f"{self.name} ({self.command[-1]})"


@dataclass(frozen=True, slots=True)
class Tools:
    """The programs and data of the flow; `versions`: of fetched packages, for the record."""

    yosys: Tool
    nextpnr: Tool
    database: Path
    versions: tuple[tuple[str, str], ...] = ()


def fetch_tools(folder: Path | None = None, mirror: str | None = None) -> Tools:
    """Fetch what is missing (some 50 MB), verified by apt's signed lists. Raises PackagesUnavailable."""
    return _of_tree(fetch(PACKAGES, folder, mirror=mirror))


def find_tools(folder: Path | None = None) -> Tools:
    """Return the tools on PATH if all are there, otherwise those that were fetched.

    Raises MissingTool with one sentence for each that is missing.
    """
    on_path = {name: shutil.which(name) for name in (YOSYS, NEXTPNR)}
    tree = fetched(folder)
    if all(on_path.values()) or tree is None:
        missing = [f"{name} is not on PATH: {_HINT}" for name, path in on_path.items() if path is None]
        try:
            database: Path | None = find_database()
        except DatabaseMissing as problem:
            missing.append(str(problem))
            database = None
        if missing or database is None:
            raise MissingTool("\n".join(missing))
        yosys, nextpnr = (Tool(name, (str(path),)) for name, path in on_path.items())
        return Tools(yosys, nextpnr, database)
    return _of_tree(tree)


def fetched(folder: Path | None = None) -> PackageTree | None:
    """Return the tree of packages if they have been fetched already; fetch nothing."""
    place = folder or default_folder()
    wanted = set(PACKAGES)
    for path in sorted(place.glob("*/packages.json")) if place.is_dir() else ():
        tree = PackageTree.at(path.parent)
        if wanted <= tree.versions.keys():
            return tree
    return None


def _of_tree(tree: PackageTree) -> Tools:
    loader = _own_loader(tree)
    environment = (("PYTHONHOME", str(tree.root / "usr")),)
    yosys, nextpnr = (Tool(name, tuple(tree.command(name, loader=loader)), environment) for name in (YOSYS, NEXTPNR))
    database = tree.path("usr/share/prjxray/database")
    return Tools(yosys, nextpnr, database, tuple(sorted(tree.versions.items())))


def _own_loader(tree: PackageTree) -> Path:
    """Put the tree's dynamic loader into a separate folder, and return it.

    The programs look for their data, and yosys for its ABC, beside the running program, which is the loader:
    so the folder has ``bin/ld.so``, ``bin/yosys-abc``, and ``share`` as in the tree.
    """
    place = tree.root / "run"
    loader = place / "bin" / "ld.so"
    if loader.is_file():
        return loader
    source = tree.loader()
    if source is None:
        raise PackagesUnavailable(f"{tree.root} has no dynamic loader")
    aside = tree.root / f".run-{os.getpid()}"
    shutil.rmtree(aside, ignore_errors=True)
    (aside / "bin").mkdir(parents=True)
    shutil.copy(source, aside / "bin" / "ld.so")
    abc = aside / "bin" / "yosys-abc"
    abc.write_text(_ABC, encoding="utf-8")
    for program in (abc, aside / "bin" / "ld.so"):
        program.chmod(program.stat().st_mode | stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH)
    (aside / "share").symlink_to("../usr/share")
    shutil.rmtree(place, ignore_errors=True)
    aside.rename(place)
    return loader
