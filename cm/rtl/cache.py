# SPDX-License-Identifier: Apache-2.0
"""Compiled things by the hash of what they were made from; several processes may make the same one at once."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path


def cache_folder() -> Path:
    """``$XDG_CACHE_HOME/fpga-cm/rtl``, by default below ``~/.cache``."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "fpga-cm" / "rtl"


def digest(parts: Iterable[str | bytes]) -> str:
    """Of texts in their order; a hash that tells where each ends."""
    found = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        found.update(len(data).to_bytes(8, "little") + data)
    return found.hexdigest()[:32]


def made(folder: Path, name: str, make: Callable[[Path, Path], None]) -> Path:
    """The file of that name, made by ``make(target, scratch folder)`` where it is not there yet.

    It appears whole or not at all: whoever is killed on the way leaves a scratch folder and nothing else.
    """
    found = folder / name
    if found.exists():
        return found
    folder.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=".making-", dir=folder))
    try:
        target = scratch / name
        make(target, scratch)
        target.replace(found)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return found
