# SPDX-License-Identifier: Apache-2.0
"""The static part's identity: a hash of everything that it is made from, the same on every machine."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path

from cm.design.generate import inputs
from cm.design.plan.system import System

STEPS = ("system", "static", "run_1")  # steps whose inputs make the locked static part, beside run_1's


def static_paths(system: System, out: Path) -> list[Path]:
    """The files that the static part is made from: generated ones below `out`, and the user's."""
    return list(dict.fromkeys(path for step in STEPS for path in inputs.of_step(system, step, out)))


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
        path = inputs.RTL / path.name
        return f"library {path.name}", path.read_bytes()
    name = Path(os.path.relpath(path, system.project.folder)).as_posix()
    return f"given {name}", path.read_bytes() if path.is_file() else b"missing"


def _add(digest: hashlib._Hash, name: str, data: bytes) -> None:
    """Add a file, with lengths before name and content, so that different lists of files never give the same bytes."""
    for part in (name.encode(), data):
        digest.update(len(part).to_bytes(8, "big") + part)
