# SPDX-License-Identifier: Apache-2.0
"""An unpacked tree of packages, whose programs can be run in place."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

MANIFEST = "packages.json"
_LIBRARIES = ("usr/lib", "lib")
_PROGRAMS = ("usr/bin", "usr/sbin", "bin")


@dataclass(frozen=True, slots=True)
class PackageTree:
    """Packages unpacked below `root`; `versions` by package name, as they were fetched."""

    root: Path
    versions: Mapping[str, str]

    @classmethod
    def at(cls, root: Path) -> PackageTree:
        """Return the complete tree at `root`, by its manifest. Raises OSError, ValueError."""
        found = json.loads((root / MANIFEST).read_text(encoding="utf-8"))
        return cls(root, MappingProxyType({item["package"]: item["version"] for item in found}))

    def path(self, inside: str) -> Path:
        """Return the path of a file of the tree, such as ``usr/share/prjxray``. Raises FileNotFoundError."""
        found = self.root / inside
        if not found.exists():
            raise FileNotFoundError(f"{inside} is not in the packages below {self.root}")
        return found

    def command(self, program: str, *arguments: str) -> list[str]:
        """Return the command line that runs a program of the tree with the tree's own libraries.

        It runs through the tree's dynamic loader, so that the machine's C library may be older. Programs that
        it starts, and files that it looks for under /usr/share, are not redirected to the tree.
        Raises FileNotFoundError if the tree has no such program.
        """
        found = next((path for folder in _PROGRAMS if (path := self.root / folder / program).is_file()), None)
        if found is None:
            raise FileNotFoundError(f"program {program} is not in the packages below {self.root}")
        loader = self.loader()
        if loader is None:
            return [str(found), *arguments]
        libraries = ":".join(map(str, self.libraries()))
        return [str(loader), "--library-path", libraries, str(found), *arguments]

    def loader(self) -> Path | None:
        """Return the dynamic loader of the tree's C library; None for a tree without one."""
        found = sorted(path for folder in _LIBRARIES for path in (self.root / folder).glob("*/ld-linux*.so.*"))
        return found[0] if found else None

    def libraries(self) -> list[Path]:
        """Return the folders of shared libraries: those of the architecture first."""
        folders = [self.root / folder for folder in _LIBRARIES]
        return [*(path for folder in folders for path in sorted(folder.glob("*-linux-gnu*"))), *folders]
