# SPDX-License-Identifier: Apache-2.0
"""File names in a build schema: relative to its folder; `*` matches files, in sorted order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from cm.schema.problems import KeyPath

Report = Callable[[KeyPath, str, str, str], None]


class PathReader:
    """Turns names into absolute paths, and reports those that do not exist."""

    def __init__(self, folder: Path, report: Report) -> None:
        self._folder, self._report = folder, report

    def many(self, names: Sequence[str] | None, key: KeyPath) -> tuple[Path, ...]:
        """The files of a list of names, in order."""
        found: list[Path] = []
        for index, name in enumerate(names or ()):
            found += self._expand(name, (*key, index))
        return tuple(found)

    def one(self, name: str | None, key: KeyPath) -> Path | None:
        """One file, or None if no name is given."""
        return next(iter(self._expand(name, key)), None) if name else None

    def _expand(self, name: str, key: KeyPath) -> list[Path]:
        pattern = Path(name)
        if "*" in name:
            base, relative = (Path("/"), str(pattern)[1:]) if pattern.is_absolute() else (self._folder, name)
            files = sorted(path for path in base.glob(relative) if path.is_file())
            if not files:
                self._report(key, "file_not_found", f"no file fits {name}", f"looked in {self._folder}")
            return files
        path = pattern if pattern.is_absolute() else self._folder / pattern
        if not path.exists():
            self._report(key, "file_not_found", f"{name} does not exist", f"looked in {self._folder}")
        return [path]
