# SPDX-License-Identifier: Apache-2.0
"""Unpacks packages and their dependencies into a folder that is either complete or does not exist.

Programs of such a tree can be run in place.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from cm.design.packages.apt import KEYRING, Apt, own_mirror, run
from cm.design.packages.apt import PackagesUnavailable as PackagesUnavailable

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

    def command(self, program: str, *arguments: str, loader: Path | None = None) -> list[str]:
        """Return the command line that runs a program of the tree with the tree's own libraries.

        It runs through the tree's dynamic loader, so that the machine's C library may be older. Programs that
        it starts, and files that it looks for under /usr/share, are not redirected to the tree. `loader`: a copy of it.
        Raises FileNotFoundError if the tree has no such program.
        """
        found = next((path for folder in _PROGRAMS if (path := self.root / folder / program).is_file()), None)
        if found is None:
            raise FileNotFoundError(f"program {program} is not in the packages below {self.root}")
        loader = loader or self.loader()
        if loader is None:
            return [str(found), *arguments]
        folders = [self.root / folder for folder in _LIBRARIES]  # those of the architecture first
        folders = [*(path for folder in folders for path in sorted(folder.glob("*-linux-gnu*"))), *folders]
        return [str(loader), "--library-path", ":".join(map(str, folders)), str(found), *arguments]

    def loader(self) -> Path | None:
        """Return the dynamic loader of the tree's C library; None for a tree without one."""
        found = sorted(path for folder in _LIBRARIES for path in (self.root / folder).glob("*/ld-linux*.so.*"))
        return found[0] if found else None


_NAME = re.compile(r"[a-z0-9][a-z0-9+.-]*(?:=[A-Za-z0-9.+:~-]+)?")
SUITE = "sid"  # nextpnr and prjxray are not in a release yet


def default_folder() -> Path:
    """Return the default place of trees: below the user's cache folder."""
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home) / "fpga-cm" / "packages"


def fetch(
    names: Sequence[str],
    folder: Path | None = None,
    *,
    suite: str = SUITE,
    mirror: str | None = None,
    keyring: Path = KEYRING,
) -> PackageTree:
    """Return a tree with these packages (``name`` or ``name=version``) and everything they depend on.

    It is below `folder` (`default_folder()`), under a name derived from the request; an existing one
    is used as it is, without a network. apt's lists are checked with Debian's keys, packages
    with the lists' hashes; no script of a package is run. A killed call leaves nothing that the next would take for
    complete, and simultaneous calls wait for each other. Remove the tree to get newer packages.

    `mirror`: by default the machine's own. Raises PackagesUnavailable with the reason, OSError.
    """
    wanted = sorted(set(names))
    for name in wanted:
        if not _NAME.fullmatch(name):
            raise PackagesUnavailable(f"{name!r} is not a name of a Debian package")
    place = (folder or default_folder()).resolve()
    place.mkdir(parents=True, exist_ok=True)
    root = place / f"{suite}-{_digest(wanted)}"
    with _locked(place / ".lock"):
        if not (root / MANIFEST).is_file():
            apt = Apt(place / f".apt-{suite}", mirror or own_mirror(), suite, keyring)
            _make(apt, wanted, root)
    return PackageTree.at(root)


def _digest(names: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(names).encode()).hexdigest()[:16]


def _make(apt: Apt, names: list[str], root: Path) -> None:
    aside = root.with_name(f".{root.name}.new")
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(root, ignore_errors=True)
    apt.prepare()
    apt.update()
    archives = aside / ".archives"
    files = apt.download(names, archives)
    if not files:
        raise PackagesUnavailable(f"apt-get fetched no package for {', '.join(names)}; is {apt.mirror} a folder here?")
    found = [_unpack(file, aside) for file in files]
    shutil.rmtree(archives)
    (aside / MANIFEST).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    os.sync()  # one call for hundreds of files, before the tree gets the name that marks it as complete
    aside.rename(root)


def _unpack(file: Path, root: Path) -> dict[str, str]:
    """Unpack one package; return its name and version for the manifest."""
    name, version = run(["dpkg-deb", "--show", "--showformat=${Package} ${Version}", str(file)]).split()
    run(["dpkg-deb", "--extract", str(file), str(root)])
    return {"package": name, "version": version, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock that other processes wait for; the kernel releases it when the process ends."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
