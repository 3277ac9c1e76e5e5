# SPDX-License-Identifier: Apache-2.0
"""Compiled things by the hash of what they were made from; several processes may make the same one at once."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

KEPT = 60  # days without a use


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
    with contextlib.suppress(FileNotFoundError):
        os.utime(found)  # it is in use
        return found
    folder.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=".making-", dir=folder))
    try:
        target = scratch / name
        make(target, scratch)
        target.replace(found)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    _forget(folder)
    return found


def _forget(folder: Path) -> None:
    """Remove what has not been asked for in KEPT days; a process that has loaded it keeps it."""
    oldest = time.time() - KEPT * 86400
    for entry in folder.iterdir():
        with contextlib.suppress(OSError):
            if entry.stat().st_mtime >= oldest:
                continue
            if entry.is_dir():
                shutil.rmtree(entry)  # of a compiler that was killed
            else:
                entry.unlink()
