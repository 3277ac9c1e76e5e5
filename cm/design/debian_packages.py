# SPDX-License-Identifier: Apache-2.0
"""Debian packages in a separate folder, without root and without changing the machine.

apt-get runs with its own sources, lists and state. The lists are verified with Debian's archive keys, each package with
the lists' hashes: apt does both. The machine's own settings (a proxy, say) stay; its sources, its lists and its state
are not used. The folder is either complete or does not exist; programs in it can be run in place.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from cm.errors import CmError
from cm.frozen import dataclass
from cm.home import cache_home

KEYRING = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
_SECONDS = 1800.0  # for one call: a slow line, and packages of hundreds of megabytes
_LINES = 8  # lines of a program's output that are shown if it fails


class PackagesUnavailable(CmError):
    """Packages cannot be fetched: a program is missing, there is no network, or there is no such package."""

    code = "packages_unavailable"


@dataclass(frozen=True, slots=True)
class Apt:
    """apt-get for one suite of one mirror, with its state in `state`."""

    state: Path
    mirror: str
    suite: str
    keyring: Path = KEYRING

    @property
    def _scratch(self) -> Path:
        return self.state / "tmp"

    def prepare(self) -> None:
        """Make the folders and the list of sources. Raises PackagesUnavailable if the keys to verify it are missing."""
        if not self.keyring.is_file():
            raise PackagesUnavailable(f"{self.keyring}: not there; install debian-archive-keyring to verify packages")
        shutil.rmtree(self._scratch, ignore_errors=True)
        for folder in ("lists/partial", "cache/archives/partial", self._scratch.name):
            (self.state / folder).mkdir(parents=True, exist_ok=True)
        (self.state / "status").touch()
        source = f"deb [signed-by={self.keyring}] {self.mirror} {self.suite} main\n"
        (self.state / "sources.list").write_text(source, encoding="utf-8")

    def update(self) -> None:
        """Fetch the lists; an expired or unsigned one is an error."""
        run(self._command("apt-get", "update", "-q", "-oAPT::Update::Error-Mode=any"), self._scratch)

    def download(self, names: list[str], place: Path) -> list[Path]:
        """Fetch packages and everything they depend on into `place`; return the files."""
        (place / "partial").mkdir(parents=True, exist_ok=True)
        options = [f"-oDir::Cache::archives={place}", "-q", "-y", "--no-install-recommends", "--download-only"]
        run(self._command("apt-get", "install", *options, "--", *names), self._scratch)
        return sorted(place.glob("*.deb"))

    def _command(self, tool: str, *arguments: str) -> list[str]:
        settings = {
            "Dir::State": self.state,
            "Dir::State::lists": self.state / "lists",
            "Dir::State::status": self.state / "status",
            "Dir::Cache": self.state / "cache",
            "Dir::Etc::sourcelist": self.state / "sources.list",
            "Dir::Etc::sourceparts": "-",
            "Dir::Etc::preferencesparts": self.state / "none",
            "APT::Sandbox::User": "",
            "APT::Get::AllowUnauthenticated": "false",
            "Acquire::AllowInsecureRepositories": "false",
            "Acquire::Languages": "none",
            "Acquire::Retries": "5",
            "APT::Update::Post-Invoke": "",
            "APT::Update::Post-Invoke-Success": "",
            "DPkg::Pre-Invoke": "",
            "DPkg::Post-Invoke": "",
        }
        return [tool, *(f"-o{name}={value}" for name, value in settings.items()), *arguments]


def run(command: list[str], scratch: Path | None = None) -> str:
    """Run a program and return its output.

    Raises PackagesUnavailable with its last lines if it fails. `scratch`: the folder for its temporary files, which a
    killed program leaves behind.
    """
    environment = {**os.environ, "LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    if scratch is not None:
        environment["TMPDIR"] = str(scratch)
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            env=environment,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    except FileNotFoundError as error:
        raise PackagesUnavailable(f"{command[0]}: not there; it comes with Debian and Ubuntu") from error
    except subprocess.TimeoutExpired as error:
        raise PackagesUnavailable(f"{command[0]}: not done after {_SECONDS:.0f} seconds") from error
    if done.returncode:
        said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
        raise PackagesUnavailable(f"{command[0]} failed: " + "; ".join(said[-_LINES:]))
    return done.stdout


def own_mirror() -> str:
    """Return the mirror from which this machine gets its Debian packages. Raises PackagesUnavailable."""
    found = run(["apt-get", "indextargets", "--format", "$(REPO_URI)"]).split()
    mirror = next((uri.rstrip("/") for uri in found if re.search(r"/debian/?$", uri)), None)
    if mirror is None:
        raise PackagesUnavailable("apt's sources name no Debian mirror: say which one (Ubuntu's has other packages)")
    return mirror


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
    return cache_home() / "fpga-cm" / "packages"


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
