# SPDX-License-Identifier: Apache-2.0
"""The cache folder: each thing built lies in a folder named after the hash of what it was made from."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from vmboard.progress import step

STAMP = ".complete"
KEEP = 2  # newest entries of one kind that stay


def default_root() -> Path:
    """`$CM_VM_CACHE`, or `cm-vm` in the user's cache folder."""
    chosen = os.environ.get("CM_VM_CACHE")
    if chosen:
        return Path(chosen).resolve()
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home).resolve() / "cm-vm"


def digest(*inputs: str | bytes | Path) -> str:
    """A short hash of texts and files; a folder counts with the names and bytes of all files in it."""
    total = hashlib.sha256()
    for item in inputs:
        for part in _parts(item):
            total.update(len(part).to_bytes(8, "little") + part)
    return total.hexdigest()[:16]


def _parts(item: str | bytes | Path) -> Iterator[bytes]:
    if isinstance(item, Path):
        for path in source_files(item):
            yield str(path.relative_to(item.parent)).encode()
            yield path.read_bytes()
    else:
        yield item.encode() if isinstance(item, str) else item


def source_files(path: Path) -> list[Path]:
    """The file itself, or the files below a folder that are neither hidden nor made by a build."""
    if path.is_file():
        return [path]
    return sorted(found for found in path.rglob("*") if found.is_file() and _is_source(found.relative_to(path)))


def _is_source(path: Path) -> bool:
    made = {".o", ".so", ".ko", ".pyc", ".mod", ".cmd", ".dtb", ".dtbo", ".order", ".symvers"}
    hidden = any(part.startswith(".") or part == "__pycache__" for part in path.parts)
    return not hidden and path.suffix not in made and not path.name.endswith(".mod.c")


class Cache:
    """Entries `<kind>-<hash>`; an entry without its stamp was interrupted."""

    def __init__(self, root: Path) -> None:
        self.root = root
        root.mkdir(parents=True, exist_ok=True)

    def entry(
        self, kind: str, inputs: Iterable[str | bytes | Path], build: Callable[[Path], None], *, resume: bool = False
    ) -> Path:
        """The folder of the thing made from `inputs`, built now if it is not there.

        An interrupted build starts from nothing, or with `resume` from what the last one left.
        """
        place = self.root / f"{kind}-{digest(*inputs)}"
        with self._lock(kind):
            if not (place / STAMP).exists():
                if not resume:
                    shutil.rmtree(place, ignore_errors=True)
                place.mkdir(parents=True, exist_ok=True)
                with step(f"building {place.name}"):
                    build(place)
                (place / STAMP).touch()
                self._prune(kind)
            os.utime(place / STAMP)
        return place

    @contextmanager
    def _lock(self, kind: str) -> Iterator[None]:
        with (self.root / f".{kind}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _prune(self, kind: str) -> None:
        same = [path for path in self.root.glob(f"{kind}-*") if path.name[len(kind) + 1 :].isalnum()]
        finished = [path for path in same if (path / STAMP).exists()]
        finished.sort(key=lambda path: (path / STAMP).stat().st_mtime, reverse=True)
        for old in finished[KEEP:]:
            shutil.rmtree(old, ignore_errors=True)
