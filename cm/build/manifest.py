# SPDX-License-Identifier: Apache-2.0
"""Writing generated files without overwriting what a user changed.

``.cm-manifest.json`` in the output folder holds the checksum of every file as it was generated. A file
that still has it is replaced. One that the user changed stays, and the new text goes beside it as
``<file>.new`` if it differs from what was generated before, as packagers do with configuration files;
the generated text that the user began from is kept below ``.cm-orig/`` for a three-way merge
(``git merge-file FILE .cm-orig/FILE FILE.new``).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cm.build.errors import BuildError

MANIFEST = ".cm-manifest.json"
ORIGINALS = ".cm-orig"


@dataclass(slots=True)
class Written:
    """What was done, as paths below the output folder."""

    created: list[str] = field(default_factory=list)
    updated: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    conflicts: list[str] = field(default_factory=list)  # changed by the user; see <file>.new
    kept: list[str] = field(default_factory=list)  # changed by the user, nothing new
    removed: list[str] = field(default_factory=list)  # no longer generated
    left: list[str] = field(default_factory=list)  # no longer generated, but changed by the user


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


class Tree:
    """A folder of generated files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._before = self._read()

    def write(self, files: Mapping[str, str]) -> Written:
        """Bring the folder to `files`; every other file in it stays as it is."""
        done = Written()
        self._folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            self._write(name, text.encode(), done)
        for name in self._before:
            if name not in files:
                self._remove(name, done)
        now = {name: digest(text.encode()) for name, text in files.items()}
        self._put(self._folder / MANIFEST, (json.dumps({"version": 1, "files": now}, indent=1) + "\n").encode())
        return done

    def _read(self) -> dict[str, str]:
        path = self._folder / MANIFEST
        if not path.exists():
            return {}
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            files = data["files"]
            return {str(name): str(value) for name, value in files.items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise BuildError(f"{path} is damaged: delete it, and changed files will be kept beside new ones") from None

    def _write(self, name: str, data: bytes, done: Written) -> None:
        path, new = self._folder / name, self._folder / f"{name}.new"
        original = self._folder / ORIGINALS / name
        have = path.read_bytes() if path.exists() else None
        if have is None or have == data:
            new.unlink(missing_ok=True)
            (done.unchanged if have == data else done.created).append(name)
        elif digest(have) == self._before.get(name) or self._ours(original, have):
            done.updated.append(name)
        elif digest(data) == self._before.get(name):
            done.kept.append(name)
            return
        else:
            done.conflicts.append(name)
            self._put(new, data)
            return
        # the original first: killed between the two, the file is still known by the manifest
        if not original.exists() or original.read_bytes() != data:
            self._put(original, data)
        if have != data:
            self._put(path, data)

    @staticmethod
    def _ours(original: Path, have: bytes) -> bool:
        """Written by a generation that was killed before its manifest was."""
        return original.exists() and original.read_bytes() == have

    def _remove(self, name: str, done: Written) -> None:
        path = self._folder / name
        if not path.is_relative_to(self._folder) or ".." in Path(name).parts or not path.exists():
            return
        if digest(path.read_bytes()) == self._before[name]:
            path.unlink()
            (self._folder / ORIGINALS / name).unlink(missing_ok=True)
            done.removed.append(name)
        else:
            done.left.append(name)

    @staticmethod
    def _put(path: Path, data: bytes) -> None:
        """Write at once or not at all; a file that is the same keeps its time stamp by not being written."""
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f".{path.name}.part")
        part.write_bytes(data)
        part.replace(path)
