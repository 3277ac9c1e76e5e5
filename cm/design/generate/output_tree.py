# SPDX-License-Identifier: Apache-2.0
"""Writes generated files without overwriting what a user changed.

``.cm-manifest.json`` in the output folder holds the checksum of every file as generated. A file that still matches
is replaced. A file that the user changed stays; if the newly generated text differs from the last one, it is put
beside the file as ``<file>.new``, as package managers do with configuration files. The generated text that the user
started from is kept below ``.cm-orig/`` for a three-way merge (``git merge-file FILE .cm-orig/FILE FILE.new``), and
so is a copy of ``<file>.new``. Deleting ``<file>.new`` marks it as merged: that copy is then the base of the next
merge. A ``<file>.new`` that differs from its copy was edited by the user, and moves to ``<file>.new.1`` before it
would be replaced.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cm.design.errors import BuildError
from cm.hashes import sha256

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


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, in a folder that is made if need be."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(data)
    part.replace(path)


class Tree:
    """A folder of generated files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._before, self._ours = self._read()

    def behind(self, files: Mapping[str, str]) -> list[str]:
        """Return the names whose text in `files` differs from what was last generated."""
        return sorted(
            name
            for name in files.keys() | self._before.keys()
            if name not in files or sha256(files[name].encode()) != self._before.get(name)
        )

    def write(self, files: Mapping[str, str]) -> Written:
        """Write `files` into the folder and remove what is no longer generated; other files stay."""
        done = Written()
        self._folder.mkdir(parents=True, exist_ok=True)
        now = {name: sha256(text.encode()) for name, text in files.items()}
        if now != self._before:  # if killed from here on, the next generation knows what this one wrote
            for name, value in now.items():
                self._ours.setdefault(name, set()).add(value)
            self._record(self._before, self._ours)
        for name, text in files.items():
            self._write(name, text.encode(), done)
        for name in sorted(self._ours.keys() - files.keys()):
            self._remove(name, done)
        self._record(now, {})
        return done

    def _read(self) -> tuple[dict[str, str], dict[str, set[str]]]:
        """Read the checksums of the last complete generation, and of every version that may have been left here."""
        path = self._folder / MANIFEST
        if not path.exists():
            return {}, {}
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
            before = {str(name): str(value) for name, value in data["files"].items()}
            ours = {str(name): set(map(str, values)) for name, values in data.get("pending", {}).items()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise BuildError(f"{path} is damaged: delete it, and changed files will be kept beside new ones") from None
        for name, value in before.items():
            ours.setdefault(name, set()).add(value)
        return before, ours

    def _record(self, files: Mapping[str, str], pending: Mapping[str, set[str]]) -> None:
        data: dict[str, Any] = {"version": 1, "files": dict(files)}
        if pending:
            data["pending"] = {name: sorted(values) for name, values in sorted(pending.items())}
        self._put(self._folder / MANIFEST, (json.dumps(data, indent=1) + "\n").encode())

    def _write(self, name: str, data: bytes, done: Written) -> None:
        path, original = self._folder / name, self._folder / ORIGINALS / name
        have = path.read_bytes() if path.exists() else None
        if have is None or have == data:
            (done.unchanged if have == data else done.created).append(name)
        elif sha256(have) in self._ours.get(name, ()):
            done.updated.append(name)
        else:
            self._beside(name, data, done)
            return
        self._withdraw(name, data)
        if not original.exists() or original.read_bytes() != data:
            self._put(original, data)
        if have != data:
            self._put(path, data)

    def _beside(self, name: str, data: bytes, done: Written) -> None:
        """Put the new text beside a file that the user changed."""
        new, copy = (folder / f"{name}.new" for folder in (self._folder, self._folder / ORIGINALS))
        if copy.exists() and not new.exists():
            copy.replace(self._folder / ORIGINALS / name)
        if sha256(data) == self._before.get(name):
            done.kept.append(name)
            return
        done.conflicts.append(name)
        self._withdraw(name, data)
        # the copy last: if killed between the two, it must not look as if the user had deleted the new file
        self._put(new, data)
        self._put(copy, data)

    def _withdraw(self, name: str, data: bytes) -> None:
        """Remove ``<file>.new`` if it was generated (earlier, or just now as `data`); otherwise move it away."""
        new, copy = (folder / f"{name}.new" for folder in (self._folder, self._folder / ORIGINALS))
        if new.exists() and new.read_bytes() not in (data, copy.read_bytes() if copy.exists() else data):
            number = 1
            while (kept := new.with_name(f"{new.name}.{number}")).exists():
                number += 1
            new.rename(kept)
        new.unlink(missing_ok=True)
        copy.unlink(missing_ok=True)

    def _remove(self, name: str, done: Written) -> None:
        path = self._folder / name
        if not path.is_relative_to(self._folder) or ".." in Path(name).parts or not path.exists():
            return
        if sha256(path.read_bytes()) in self._ours[name]:
            path.unlink()
            (self._folder / ORIGINALS / name).unlink(missing_ok=True)
            done.removed.append(name)
        else:
            done.left.append(name)

    _put = staticmethod(write_whole)
