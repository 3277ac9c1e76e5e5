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

from cm.home import cache_home

KEPT = 60  # days without a use


def cache_folder() -> Path:
    """``$XDG_CACHE_HOME/fpga-cm/rtl``, by default below ``~/.cache``."""
    return cache_home() / "fpga-cm" / "rtl"


def digest(parts: Iterable[str | bytes]) -> str:
    """The hash of several texts, in order and with their boundaries."""
    found = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        found.update(len(data).to_bytes(8, "little") + data)
    return found.hexdigest()[:32]


def made(folder: Path, name: str, make: Callable[[Path, Path], None]) -> Path:
    """The file of that name, made by ``make(target, scratch folder)`` if it does not exist.

    It appears whole or not at all: a process that is killed leaves only a scratch folder behind.
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
    """Remove what has not been used for KEPT days; processes that have loaded it are not affected."""
    oldest = time.time() - KEPT * 86400
    for entry in folder.iterdir():
        with contextlib.suppress(OSError):
            if entry.stat().st_mtime >= oldest:
                continue
            if entry.is_dir():
                shutil.rmtree(entry)  # of a compiler that was killed
            else:
                entry.unlink()
