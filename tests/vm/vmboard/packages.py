# SPDX-License-Identifier: Apache-2.0
"""Packages of another architecture through the machine's own apt.

The sources, keys and preferences are those in /etc/apt; the lists, the state and the downloads lie in the cache,
so the machine itself neither learns of the foreign architecture nor needs root.
"""

from __future__ import annotations

import fcntl
import lzma
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vmboard.arch import Arch
from vmboard.errors import MissingError
from vmboard.progress import step
from vmboard.shell import require, run

LISTS_MAX_AGE_S = 12 * 3600
_AR = b"!<arch>\n"
KEYRING = "/usr/share/keyrings/debian-archive-keyring.gpg"


class Apt:
    """apt-get for one architecture with state of its own; of the machine's sources, or of one suite of their mirror."""

    def __init__(self, root: Path, arch: Arch, suite: str = "") -> None:
        self.arch = arch
        self._root = root / "-".join(filter(None, ["apt", arch.debian, suite]))
        self._suite = suite

    def _command(self, tool: str, archives: Path | None = None) -> list[str]:
        options = {
            "APT::Architecture": self.arch.debian,
            "APT::Architectures": self.arch.debian,
            "APT::Sandbox::User": "",
            "APT::Install-Recommends": "false",
            "Acquire::Retries": "5",
            "Dir::State": self._root / "state",
            "Dir::State::status": self._root / "status",
            "Dir::Cache": self._root / "cache",
            "Dir::Cache::archives": archives or self._root / "cache/archives",
            "DPkg::Post-Invoke": "",
            "APT::Update::Post-Invoke": "",
        }
        if self._suite:
            options |= {"Dir::Etc::sourcelist": self._root / "sources.list", "Dir::Etc::sourceparts": "-"}
            options |= {"Dir::Etc::preferencesparts": "-", "APT::Update::Error-Mode": "any"}
        return [tool, *(f"-o{name}={value}" for name, value in options.items())]

    @property
    def _scratch(self) -> dict[str, str]:
        """Where apt's temporary files go: one that is killed leaves them."""
        return {"TMPDIR": str(self._root / "tmp")}

    @contextmanager
    def _lists(self) -> Iterator[None]:
        """The lists, for one at a time: boards are built side by side, and apt does not wait for another."""
        self._root.mkdir(parents=True, exist_ok=True)
        with (self._root / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            shutil.rmtree(self._root / "tmp", ignore_errors=True)
            (self._root / "tmp").mkdir()
            self._refresh()
            yield

    def _refresh(self) -> None:
        """Fetch the package lists, unless those of the last hours are there."""
        require("apt-get", "dpkg-deb", "tar")
        stamp = self._root / "fetched"
        if stamp.exists() and time.time() - stamp.stat().st_mtime < LISTS_MAX_AGE_S:
            return
        for folder in ("state/lists/partial", "cache/archives/partial"):
            (self._root / folder).mkdir(parents=True, exist_ok=True)
        (self._root / "status").touch()
        if self._suite:
            (self._root / "sources.list").write_text(f"deb [signed-by={KEYRING}] {_mirror()} {self._suite} main\n")
        with step(f"fetching the {self.arch.debian} package lists"):
            run([*self._command("apt-get"), "update", "-q"], env=self._scratch)
        stamp.touch()

    def closure(self, names: list[str], place: Path) -> list[Path]:
        """Download packages with all they depend on into `place`; returns the files."""
        (place / "partial").mkdir(parents=True, exist_ok=True)
        with self._lists():
            run([*self._command("apt-get", place), "install", "-q", "-y", "--download-only", *names], env=self._scratch)
        return sorted(place.glob("*.deb"))

    def download(self, names: list[str], place: Path) -> list[Path]:
        """Download just these packages into `place`; returns the files."""
        place.mkdir(parents=True, exist_ok=True)
        with self._lists():
            run([*self._command("apt-get"), "download", "-q", *names], cwd=place, env=self._scratch)
        return sorted(place.glob("*.deb"))

    def known(self, names: list[str]) -> list[str]:
        """Those of the packages that there are."""
        with self._lists():
            there = set(run([*self._command("apt-cache"), "pkgnames"], env=self._scratch).split())
        return [name for name in names if name in there]

    def depends_like(self, name: str, pattern: str) -> str:
        """The first dependency of a (meta) package that matches a pattern, such as the current kernel's."""
        with self._lists():
            listing = run([*self._command("apt-cache"), "depends", name], env=self._scratch)
        found = re.search(rf"Depends: ({pattern})$", listing, re.MULTILINE)
        if found is None:
            raise LookupError(f"package {name} ({self.arch.debian}) depends on nothing like {pattern}:\n{listing}")
        return found.group(1)


def _mirror() -> str:
    """The mirror that this machine has its Debian packages from."""
    found = run(["apt-get", "indextargets", "--format", "$(REPO_URI)"]).split()
    mirror = next((uri.rstrip("/") for uri in found if re.search(r"/debian/?$", uri)), None)
    if mirror is None:
        raise MissingError("apt's sources name no Debian mirror")
    return mirror


def inflated(deb: Path, target: Path) -> None:
    """The same package with nothing compressed: an emulated processor unpacks that many times faster."""
    with deb.open("rb") as packed, target.open("wb") as out:
        out.write(packed.read(len(_AR)))
        while header := packed.read(60):  # ar(5)
            name, data = header[:16].rstrip(), packed.read(int(header[48:58]))
            packed.read(len(data) % 2)
            if name.endswith(b".xz"):
                name, data = name.removesuffix(b".xz"), lzma.decompress(data)
            out.write(
                name.ljust(16) + header[16:48] + b"%-10d" % len(data) + header[58:] + data + b"\n" * (len(data) % 2)
            )


def unpack(debs: list[Path], target: Path) -> None:
    """Extract packages over one another without running anything of them; merged /usr stays merged."""
    for folder in ("usr/bin", "usr/sbin", "usr/lib"):
        (target / folder).mkdir(parents=True, exist_ok=True)
        link = target / Path(folder).name
        if not link.is_symlink():
            link.symlink_to(folder)
    for deb in debs:
        with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", str(deb)], stdout=subprocess.PIPE) as packed:
            subprocess.run(
                ["tar", "-x", "-f", "-", "--keep-directory-symlink", "-C", str(target)], stdin=packed.stdout, check=True
            )
